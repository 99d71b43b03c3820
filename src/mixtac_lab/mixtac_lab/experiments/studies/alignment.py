# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What clock errors in the labels cost: the command `experiments alignment`.

FGER-Net is trained on the same simulated trials of one sensor, from the same initial weights,
with reference labels on differently aligned clocks, from none at all to the true map. It is
judged by the true force on other days of that sensor.
"""

from __future__ import annotations

import json as json_module
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Optional

import numpy as np
import typer

from mixtac_events.errors import MixtacError

if TYPE_CHECKING:
    from collections.abc import Callable

    from mixtac_alignment.bags import SensorTiming
    from mixtac_alignment.clock_fit import ClockFit
    from mixtac_alignment.refinement import Refinement
    from mixtac_learning.trials.samples import Sample
    from mixtac_learning.trials.trial import ForceLabel
    from mixtac_sim.world.trial import Trial


LABELS: Final = ('raw', 'arrival', 'two_impulse', 'refined', 'perfect')
HOST_S: Final = (1e-3, 8e-3)
"""Time from the first event to its arrival at the host: packets of 1 to 8 ms."""
REFERENCE_HOST_S: Final = (1e-4, 1e-3)
"""The same for a sample of the reference sensor."""


@dataclass(frozen=True, slots=True)
class Map:
    """A clock map t_reference = rate * t_camera + offset_us [us], and its error [ms]."""

    rate: float
    offset_us: float
    error_ms: float


def clock_maps(trials: list[Trial], seed: int) -> dict[str, list[Map]]:
    """Return the maps of trials of one sensor by the kinds of `LABELS`.

    Args:
        trials: Trials of one sensor with taps at both ends.
        seed: Of how long packets take to the host.

    `raw` takes both clocks for one. `arrival` is the difference of the clocks by the times at which
    the host got the first data: the clocks' offset, wrong by how long packets take to the host,
    with the sensor's delay and the drift left in. `two_impulse` and `refined` are as `mixtac align`
    on a folder fits them, `perfect` is the truth.
    """
    from mixtac_alignment.bags import pool_sensor

    rng = np.random.default_rng(seed)
    maps: dict[str, list[Map]] = {name: [] for name in LABELS}
    alone = [_fit(trial, None) for trial in trials]
    known = pool_sensor([refined for _, refined in alone])
    for trial in trials:
        first, refined = _fit(trial, known)
        rate, offset_us = trial.clock
        late_us = 1e6 * (rng.uniform(*REFERENCE_HOST_S) - rng.uniform(*HOST_S))
        maps['raw'].append(_rated(1.0, 0.0, trial))
        maps['arrival'].append(_rated(1.0, offset_us - late_us, trial))
        maps['two_impulse'].append(_rated(*_plain(first), trial))
        maps['refined'].append(_rated(*_plain(refined.fit), trial))
        maps['perfect'].append(_rated(rate, offset_us + trial.reference_delay_us, trial))
    return maps


def _fit(trial: Trial, known: SensorTiming | None) -> tuple[ClockFit, Refinement]:
    from mixtac_alignment.histories import EventCounts, FrameFeatures, by_cell, reduce_frame
    from mixtac_alignment.refinement import refine
    from mixtac_alignment.taps import fit_taps

    rows, columns = trial.frames.shape[1:]
    values = np.stack([reduce_frame(frame, 1023.0) for frame in trial.frames])
    frames = FrameFeatures(trial.exposure_start_us, trial.exposure_end_us, values)
    force = (trial.reference_t_us.astype(np.float64) * 1e-6, trial.reference_wrench[:, 2])
    settings, lag = (None, None) if known is None else (known.parameters, known.lag)
    counts, events = EventCounts.of(trial.events.t), by_cell(trial.events, columns, rows)
    first = fit_taps(counts, events, frames, *force, settings, lag)
    return first, refine(first, frames, *force, lag)


def _plain(fit: ClockFit) -> tuple[float, float]:
    return fit.a, 1e6 * fit.paper_offset_s


def _rated(rate: float, offset_us: float, trial: Trial) -> Map:
    t_us = np.linspace(0.0, float(trial.events.t[-1]), 41)
    true_us = trial.clock[0] * t_us + trial.clock[1] + trial.reference_delay_us
    error = np.abs(rate * t_us + offset_us - true_us)
    return Map(rate, offset_us, 1e-3 * float(error.mean()))


OptionalPath = Optional[Path]  # noqa: UP045  (typer evaluates this under Python 3.10)
FIRST_SEED: Final = 620_000
PROFILES: Final = ('dynamic', 'oscillation', 'impact', 'demo')


@dataclass(frozen=True)
class Plan:
    """What is trained and judged.

    Attributes:
        trials: Trials to train on.
        checks: Trials to judge by.
        seconds: Length of a trial [s].
        epochs: Epochs of the recurrent stage; half as many of the frame stage, a sixth of both.
        seeds: Trainings per kind of label.
        preset: How hard the sensor is.
    """

    trials: int = 16
    checks: int = 4
    seconds: float = 12.0
    epochs: int = 30
    seeds: int = 2
    preset: str = 'paper_like'


def alignment(
    trials: Annotated[int, typer.Option(min=4, help='Trials to train on.')] = Plan.trials,
    checks: Annotated[int, typer.Option(min=1, help='Trials to judge by.')] = Plan.checks,
    seconds: Annotated[float, typer.Option(min=10, help='Length of a trial.')] = Plan.seconds,
    epochs: Annotated[int, typer.Option(min=1, help='Epochs of the recurrent stage.')] = (
        Plan.epochs
    ),
    seeds: Annotated[int, typer.Option(min=1, help='Trainings per row.')] = Plan.seeds,
    preset: Annotated[str, typer.Option(help='easy, paper_like or hard.')] = Plan.preset,
    json: Annotated[
        OptionalPath,
        typer.Option(help='File of the figures; trainings that it holds are not repeated.'),
    ] = None,
) -> None:
    """Train on labels with raw, coarse, tapped, refined and perfect clocks; compare the errors."""
    from rich.console import Console
    from rich.progress import Progress

    plan = Plan(trials, checks, seconds, epochs, seeds, preset)
    with Progress(transient=True) as progress:
        steps = progress.add_task('learning', total=trials + checks + len(LABELS) * seeds)
        figures = measure(plan, json, lambda: progress.advance(steps))
    Console().print(_table(plan, figures))


def measure(plan: Plan, report: Path | None, advance: Callable[[], None]) -> dict[str, Any]:
    """Return the figures of every training.

    Args:
        plan: What is trained and judged.
        report: Figures of an earlier run of the same plan are taken from there, new ones added
            after each training; none for neither.
        advance: Called after each step.

    Returns:
        Per kind of label: the mean absolute error of the clock in the labels, `time_error_ms`, and
        `trainings`, by seed: `mae` and `rmse` [N], and `rmse` by profile.

    Raises:
        MixtacError: The report is that of another plan.
    """
    figures = _reported(plan, report)
    learned, judged, kept = _samples(plan, advance)
    maps = clock_maps(kept, FIRST_SEED)
    for seed in range(plan.seeds):
        for name in LABELS:
            row = figures.setdefault(name, {'trainings': {}})
            row['time_error_ms'] = float(np.mean([one.error_ms for one in maps[name]]))
            if str(seed) not in row['trainings']:
                labelled = [
                    _relabelled(*each) for each in zip(learned, kept, maps[name], strict=True)
                ]
                row['trainings'][str(seed)] = _train_and_judge(labelled, judged, plan, seed)
                if report is not None:
                    content = {'plan': asdict(plan), 'figures': figures}
                    report.write_text(json_module.dumps(content, indent=2) + '\n', encoding='utf-8')
            advance()
    return figures


def _reported(plan: Plan, report: Path | None) -> dict[str, Any]:
    """Return the figures of an earlier run of the same plan; seeds may be added to it."""
    if report is None or not report.exists():
        return {}
    content = json_module.loads(report.read_text(encoding='utf-8'))
    if {**content['plan'], 'seeds': plan.seeds} != asdict(plan):
        raise MixtacError(
            f'{report} holds the figures of another plan ({content["plan"]}): name another file, '
            'or give the same options'
        )
    figures: dict[str, Any] = content['figures']
    return figures


def _samples(
    plan: Plan, advance: Callable[[], None]
) -> tuple[list[Sample], list[Sample], list[Trial]]:
    """Return samples to train on and to judge by, with the true force, and the former's trials."""
    from mixtac_fger.config import FgerConfig
    from mixtac_learning.trials.samples import make_sample
    from mixtac_learning.trials.simulated import arrays_of

    samples: list[Sample] = []
    kept: list[Trial] = []
    for number in range(plan.trials + plan.checks):
        trial = _trial(number, plan.seconds, plan.preset)
        origin = {'device_seed': 0}
        arrays = arrays_of(trial, origin)
        samples.append(make_sample(FgerConfig(), arrays, arrays.label(), origin))
        if number < plan.trials:
            kept.append(trial)
        advance()
    return samples[: plan.trials], samples[plan.trials :], kept


def _trial(number: int, seconds: float, preset: str) -> Trial:
    from mixtac_sim.world.effects import preset as named
    from mixtac_sim.world.trial import simulate_trial

    profile = PROFILES[number % len(PROFILES)]
    seed = FIRST_SEED + number
    return simulate_trial(FIRST_SEED, seed, profile, seconds, sync=True, preset=named(preset))


def _relabelled(sample: Sample, trial: Trial, clock: Map) -> Sample:
    """Return a sample with the labels that a clock map gives."""
    from mixtac_fger.config import FgerConfig
    from mixtac_learning.trials.trial import aligned_force

    first = FgerConfig().reference_frames - 1
    label: ForceLabel = aligned_force(
        trial.reference_t_us, trial.reference_wrench[:, 2], clock.rate, clock.offset_us
    )
    exposures = label.mean(trial.exposure_start_us, trial.exposure_end_us)
    return replace(sample, force=label.at(sample.window_end_us), frame_force=exposures[first:])


def _train_and_judge(
    learned: list[Sample], judged: list[Sample], plan: Plan, seed: int
) -> dict[str, Any]:
    """Return errors [N] on trials that were not trained on."""
    import torch

    from mixtac_fger.config import FgerConfig
    from mixtac_learning.train.batches import stack
    from mixtac_learning.train.config import TrainingSettings
    from mixtac_learning.train.trainer import Trainer, estimate

    settings = TrainingSettings(
        seed=seed,
        frame_epochs=max(1, plan.epochs // 2),
        recurrent_epochs=plan.epochs,
        joint_epochs=plan.epochs // 6,
        # The uncertainty is not judged.
        deviation_epochs=0,
    )
    network = Trainer(FgerConfig(), settings).run(stack(learned))
    sequences = stack(judged)
    with torch.no_grad():
        force, _ = estimate(network, sequences)
    error = torch.where(sequences.valid, force - sequences.force, 0.0)
    windows = sequences.valid.sum(dim=0)
    if int(windows.min()) == 0:
        raise MixtacError('no windows to judge by: give longer trials')
    square = error.square().sum(dim=0)
    return {
        'mae': float(error.abs().sum() / windows.sum()),
        'rmse': float((square.sum() / windows.sum()).sqrt()),
        'rmse_by_profile': {
            PROFILES[k]: float((square[at].sum() / windows[at].sum()).sqrt())
            for k in range(len(PROFILES))
            if (at := [i for i in range(len(judged)) if (plan.trials + i) % len(PROFILES) == k])
        },
    }


def _table(plan: Plan, figures: dict[str, Any]) -> Any:  # noqa: ANN401
    from rich.table import Table

    title = (
        f'FGER-Net on {plan.preset}, simulated: {plan.trials} trials of {plan.seconds:g} s, '
        f'{plan.epochs} epochs, {plan.seeds} trainings'
    )
    table = Table(title=title, title_justify='left')
    table.add_column('clocks')
    for heading in ('time error [ms]', 'MAE [N]', 'RMSE [N]', *(f'{p} RMSE' for p in PROFILES)):
        table.add_column(heading, justify='right')
    for name, row in figures.items():
        runs = list(row['trainings'].values())
        cells = [[run[key] for run in runs] for key in ('mae', 'rmse')]
        cells += [[r['rmse_by_profile'].get(p, np.nan) for r in runs] for p in PROFILES]
        shown = [f'{np.mean(cell):.4f} +- {np.std(cell):.4f}' for cell in cells]
        table.add_row(name, f'{row["time_error_ms"]:.2f}', *shown)
    return table
