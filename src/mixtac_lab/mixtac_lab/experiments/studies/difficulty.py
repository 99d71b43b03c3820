# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""How difficult simulated trials are: what simpler estimators than FGER-Net achieve on them.

A simulator in which the mean brightness or the events alone reveal the force would prove nothing
about a network that fuses both. `difficulty` compares such estimators; `ablation` switches off
one effect of the simulator at a time.

The event integrator is a linear map from events to increments of the force, summed over time. It
sees one image from before the first contact. Its error grows with time: this is the drift that
frames correct.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console

from mixtac_cli.figures import make_table, progress_bar
from mixtac_cli.options import JsonFile, ModelName, Preset
from mixtac_fger.weights import DEFAULT_MODEL, Model, find_model, read_model
from mixtac_lab.experiments.harness import pooled
from mixtac_lab.experiments.paper.vibration import cell_sums
from mixtac_lab.experiments.sizes import PRESET
from mixtac_learning.judge.estimators import TrialEstimate, stream
from mixtac_learning.judge.metrics import fit_scale, measure
from mixtac_learning.trials.simulated import SimulatedSource
from mixtac_learning.trials.trial import DatasetError, ForceLabel, TrialArrays
from mixtac_node.files import write_json
from mixtac_sim.world.effects import EFFECTS
from mixtac_sim.world.training_trials import (
    TrialSpec,
    calibration_plan,
    evaluation_plan,
    unseen_devices,
)

WINDOW_US = 10_000
"""Window of an increment [us]; a linear sum does not depend on it, but the noise of a fit does."""
CELL_PX = 44
"""Side of a cell [px]: eight columns and six rows."""
RIDGES = (0.01, 0.1, 1.0, 10.0, 100.0)
"""Penalties to choose from, in mean squares of the standardised features."""


@dataclass(frozen=True, slots=True, eq=False)
class Increments:
    """Events and force of one trial in windows that start at the end of the image.

    Attributes:
        t_us: Ends of the windows, camera clock [us], int64 [n].
        features: Sums per cell of polarity times the image's log-gradient (x, y), ON and OFF
            events, float64 [n, 4 * cells].
        force: True force at the ends [n + 1] [N]; the first is the start of the integral.
    """

    t_us: NDArray[np.int64]
    features: NDArray[np.float64]
    force: NDArray[np.float64]


def increments(trial: TrialArrays, label: ForceLabel, reference_frames: int) -> Increments:
    """Return the windows of a trial.

    Args:
        trial: Events and frames; only the first frames are used.
        label: True force on the camera clock.
        reference_frames: Number of frames before the first contact.

    Raises:
        DatasetError: The trial ends before its reference frames do.
    """
    span_us = int(trial.exposure_end_us[reference_frames - 1]), int(label.t_us[-1])
    edges = np.arange(span_us[0], span_us[1] + 1, WINDOW_US)
    if len(edges) < 3:
        raise DatasetError(f'trial ends {edges.size * WINDOW_US} us after its reference frames')
    image = trial.frames[:reference_frames].mean(axis=0)
    features = np.hstack(list(cell_sums(trial.events, image, span_us, WINDOW_US, CELL_PX)))
    return Increments(edges[1:], features, label.at(edges).astype(np.float64))


@dataclass(frozen=True, slots=True, eq=False)
class EventIntegrator:
    """A linear map from the events of a window to the increment of the force [N].

    Attributes:
        gains: Increment per unit of each feature [4 * cells] [N].
        offset: Increment of a window without events [N]; it compensates the noise.
    """

    gains: NDArray[np.float64]
    offset: float = 0.0

    @classmethod
    def fit(cls, trials: Sequence[Increments], ridge: float = RIDGES[0]) -> EventIntegrator:
        """Return the least-squares map over training trials.

        Args:
            trials: Training trials.
            ridge: Penalty of large gains.
        """
        features = np.concatenate([trial.features for trial in trials])
        change = np.concatenate([np.diff(trial.force) for trial in trials])
        centre, scale = features.mean(axis=0), features.std(axis=0) + 1e-9
        even = (features - centre) / scale
        square = even.T @ even / len(even)
        square[np.diag_indices_from(square)] += ridge
        gains = np.linalg.solve(square, even.T @ (change - change.mean()) / len(even)) / scale
        return cls(gains, float(change.mean() - centre @ gains))

    @classmethod
    def choose(cls, trials: Sequence[Increments]) -> EventIntegrator:
        """Return the map with the penalty that integrates best in cross-validation.

        Args:
            trials: Training trials, two or more; each is left out once.
        """

        def error(ridge: float) -> float:
            quarters = [
                judge_integrator(cls.fit([t for t in trials if t is not out], ridge), [out])[0]
                for out in trials
            ]
            return float(np.mean(quarters))

        return cls.fit(trials, min(RIDGES, key=error))

    def changes(self, trial: Increments) -> NDArray[np.float64]:
        """Return the increment of each window [n] [N]."""
        return np.asarray(trial.features @ self.gains + self.offset)

    def integrate(self, trial: Increments) -> NDArray[np.float64]:
        """Return the force at the end of each window [n] [N], starting from the true force."""
        return np.asarray(trial.force[0] + np.cumsum(self.changes(trial)))


def judge_integrator(
    integrator: EventIntegrator, trials: Sequence[Increments]
) -> tuple[NDArray[np.float64], float]:
    """Return mean absolute errors in four quarters of each trial, and R2 of the increments.

    Args:
        integrator: Fitted to other trials.
        trials: Trials without fit.

    Returns:
        Errors [trial, 4] [N], and R2 of the increments.
    """
    quarters, truth, found = [], [], []
    for trial in trials:
        error = np.abs(integrator.integrate(trial) - trial.force[1:])
        quarters.append([part.mean() for part in np.array_split(error, 4)])
        truth.append(np.diff(trial.force))
        found.append(integrator.changes(trial))
    return np.array(quarters), measure(np.concatenate(truth), np.concatenate(found)).r2


def summarise_integrator(quarters: NDArray[np.float64], r2: float) -> dict[str, float]:
    """Return the figures of a report.

    Args:
        quarters: Errors from `judge_integrator` [trial, 4] [N].
        r2: R2 of the increments.

    Returns:
        `integrator_increment_r2`; `integrator_early_mae` and `integrator_late_mae` [N] in the first
        and last quarter with their spreads between trials (`_sd`); `integrator_growth`, the ratio
        of the means; `integrator_growing`, the share of trials whose error grows.
    """
    early, late = quarters[:, 0], quarters[:, -1]
    return {
        'integrator_increment_r2': r2,
        'integrator_early_mae': float(early.mean()),
        'integrator_early_sd': float(early.std()),
        'integrator_late_mae': float(late.mean()),
        'integrator_late_sd': float(late.std()),
        'integrator_growth': float(late.mean() / early.mean()),
        'integrator_growing': float(np.mean(late > early)),
    }


def sensor_scales(press: TrialEstimate) -> tuple[float, float]:
    """Return the gains of a sensor that one calibration press gives.

    Returns:
        Gain of the whole network, and that of its frames-only force.

    Raises:
        CalibrationError: The trial is not a press.
    """
    fused = fit_scale(press.force, press.known)
    return fused, fit_scale(_frames_only(press), press.known)


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """Estimates of one trial.

    Attributes:
        run: Estimates with all frames, scaled.
        blind: Estimates from events alone, without any frame after the reference, scaled.
        brightness: Ratio of the mean brightness of the latest frame to that of the first frames.
        counts: Events per window.
    """

    run: TrialEstimate
    blind: TrialEstimate
    brightness: NDArray[np.float64]
    counts: NDArray[np.float64]


def _frames_only(estimate: TrialEstimate) -> NDArray[np.float64]:
    if estimate.frames_only is None:
        raise DatasetError(f'the model gives no force of frames alone for {estimate.name}')
    return estimate.frames_only


def judge(model: Model, trial: TrialArrays, scales: tuple[float, float]) -> Judged:
    """Run all estimators on a trial.

    Args:
        model: Content of a weight file of FGER-Net.
        trial: A simulated trial.
        scales: Gains of the sensor, from `sensor_scales`.
    """
    kept = model.config['reference_frames']
    run = stream(model, trial)
    blind = stream(model, trial, frames=kept)
    brightness = _brightness(trial, run.t_us, kept)
    cuts = np.searchsorted(trial.events.t, [run.t_us[0] - model.config['window_us'], *run.t_us])
    fused, frames = scales
    both = replace(run.scaled(fused), frames_only=frames * _frames_only(run))
    return Judged(both, blind.scaled(fused), brightness, np.diff(cuts).astype(np.float64))


def _brightness(trial: TrialArrays, t_us: NDArray[np.int64], kept: int) -> NDArray[np.float64]:
    means = trial.frames.reshape(len(trial.frames), -1).mean(axis=1)
    latest = np.searchsorted(trial.arrival_us, t_us, side='right') - 1
    return np.asarray(means[np.maximum(latest, 0)] / means[:kept].mean(), np.float64)


def summarise(judged: Sequence[Judged]) -> dict[str, float]:
    """Return the figures over trials.

    Returns:
        `fused_mae`, `frames_only_mae` [N] and their ratio; `events_only_early_mae` and
        `events_only_late_mae` [N], in the first and last quarter of the trials, and
        `events_only_drift` [N/s], the slope of the absolute error; `r2_brightness` and `r2_count`,
        R2 of the best straight line through all trials.
    """
    truth = np.concatenate([each.run.known for each in judged])
    fused = pooled([each.run for each in judged]).mae
    framed = [replace(each.run, force=_frames_only(each.run)) for each in judged]
    frames = pooled(framed).mae
    early, late, slope = _drift([each.blind for each in judged])
    return {
        'trials': len(judged),
        'fused_mae': fused,
        'frames_only_mae': frames,
        'frames_only_over_fused': frames / fused,
        'events_only_early_mae': early,
        'events_only_late_mae': late,
        'events_only_drift': slope,
        'r2_brightness': explained(np.concatenate([each.brightness for each in judged]), truth),
        'r2_count': explained(np.concatenate([each.counts for each in judged]), truth),
    }


def _drift(runs: Sequence[TrialEstimate]) -> tuple[float, float, float]:
    quarters, slopes = [], []
    for run in runs:
        error = np.abs(run.force - run.known)
        part = len(error) // 4
        quarters.append((error[:part].mean(), error[-part:].mean()))
        slopes.append(np.polyfit((run.t_us - run.t_us[0]) / 1e6, error, 1)[0])
    early, late = np.mean(quarters, axis=0)
    return float(early), float(late), float(np.mean(slopes))


def explained(feature: NDArray[np.floating], truth: NDArray[np.floating]) -> float:
    """Return R2 of the least-squares line from a feature to the truth, fitted to the same data."""
    if np.ptp(feature) == 0.0:
        return 0.0
    return float(np.corrcoef(feature, truth)[0, 1] ** 2)


Devices = Annotated[int, typer.Option(min=1, help='Number of unseen sensors.')]
Seconds = Annotated[float, typer.Option(min=6, help='Length of a trial (s).')]
Seed = Annotated[int, typer.Option(min=3, help='Random seed of sensors and days.')]
LESSONS = 4
"""Trials of a sensor to which its event integrator is fitted."""
LESSON = 50
"""Offset of their trial seeds from that of the test trial."""


def difficulty(
    preset: Preset = PRESET,
    model: ModelName = DEFAULT_MODEL,
    devices: Devices = 4,
    seconds: Seconds = 20.0,
    seed: Seed = 3,
    json: JsonFile = None,
) -> None:
    """Show what frames alone, events alone, brightness and event counts reveal of the force."""
    specs, presses = _plans(preset, devices, seconds, seed)
    loaded = read_model(find_model(model))
    with progress_bar('testing', len(specs) * (2 + LESSONS) + len(presses)) as advance:
        figures = _judge_all(loaded, specs, presses, advance)
        figures |= _integrate_all(loaded.config['reference_frames'], specs, advance)
    shown = [(name.replace('_', ' '), f'{value:.4g}') for name, value in figures.items()]
    Console(markup=False).print(
        make_table(f'dynamic, {preset}, simulated', ('figure', 'value'), shown)
    )
    write_json(json, {'preset': preset, 'model': str(find_model(model)), **figures})


def ablation(
    preset: Preset = PRESET,
    model: ModelName = DEFAULT_MODEL,
    devices: Devices = 4,
    seconds: Seconds = 12.0,
    seed: Seed = 3,
    json: JsonFile = None,
) -> None:
    """Show how the error changes when one effect of the simulated sensor is switched off."""
    specs, presses = _plans(preset, devices, seconds, seed)
    names = ['', *EFFECTS]
    rows = {}
    loaded = read_model(find_model(model))
    with progress_bar('testing', (len(specs) + len(presses)) * len(names)) as advance:
        for name in names:
            dynamic, press = (
                [replace(spec, without=name) for spec in part] for part in (specs, presses)
            )
            rows[name or 'all effects'] = _judge_all(loaded, dynamic, press, advance)
    whole = rows['all effects']['fused_mae']
    shown = [
        (
            name,
            f'{row["fused_mae"]:.4f}',
            f'{1.0 - row["fused_mae"] / whole:+.1%}',
            f'{row["frames_only_mae"]:.4f}',
        )
        for name, row in rows.items()
    ]
    headings = ('off', 'MAE [N]', 'share of the error', 'frames only [N]')
    Console(markup=False).print(
        make_table(f'dynamic, {preset}, simulated: one effect off', headings, shown)
    )
    write_json(json, {'preset': preset, 'model': str(find_model(model)), 'rows': rows})


def _plans(
    preset: str, devices: int, seconds: float, seed: int
) -> tuple[list[TrialSpec], list[TrialSpec]]:
    seeds = unseen_devices(devices, seed)
    specs = evaluation_plan(seeds, seconds, seed, ('dynamic',), preset)
    return specs, calibration_plan(seeds, 8.0, seed, preset)


def _judge_all(
    model: Model,
    specs: Sequence[TrialSpec],
    presses: Sequence[TrialSpec],
    advance: Callable[[], None],
) -> dict[str, float]:
    scales = {}
    for spec in presses:
        scales[spec.device_seed] = sensor_scales(stream(model, SimulatedSource(spec).load()))
        advance()
    judged = []
    for spec in specs:
        judged.append(judge(model, SimulatedSource(spec).load(), scales[spec.device_seed]))
        advance()
    return summarise(judged)


def _integrate_all(
    reference_frames: int, specs: Sequence[TrialSpec], advance: Callable[[], None]
) -> dict[str, float]:
    """Return the figures of an event integrator of each sensor, fitted to other trials of it."""

    def windows(spec: TrialSpec) -> Increments:
        trial = SimulatedSource(spec).load()
        advance()
        return increments(trial, trial.label(), reference_frames)

    rows, fits = [], []
    for spec in specs:
        days = [replace(spec, trial_seed=spec.trial_seed + LESSON + k) for k in range(LESSONS)]
        integrator = EventIntegrator.choose([windows(day) for day in days])
        quarters, r2 = judge_integrator(integrator, [windows(spec)])
        rows.append(quarters)
        fits.append(r2)
    return summarise_integrator(np.concatenate(rows), float(np.mean(fits)))
