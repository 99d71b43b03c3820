# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The command `experiments alignment`: what errors of the clocks cost a learner.

FGER-Net is trained on the same simulated trials of one sensor, from the same initial weights, with
labels from the reference sensor on differently aligned clocks, and judged on other days of that
sensor by the true force.
"""

from __future__ import annotations

import json as json_module
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Optional

import numpy as np
import typer

from mixtac_events.errors import MixtacError

if TYPE_CHECKING:
    from collections.abc import Callable

    from mixtac_alignment.clock_fit import ClockFit
    from mixtac_alignment.refinement import Refinement
    from mixtac_alignment.sensor_pool import SensorTiming
    from mixtac_fger.dataset import ForceLabel, Sample
    from mixtac_sim.trial import Trial

OptionalPath = Optional[Path]  # noqa: UP045  (typer evaluates this under Python 3.10)
FIRST_SEED: Final = 620_000
PROFILES: Final = ('dynamic', 'oscillation', 'impact', 'demo')
LABELS: Final = ('none', 'two_impulse', 'refined', 'perfect')
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


def alignment(
    trials: Annotated[int, typer.Option(min=4, help='Trials to train on.')] = 16,
    checks: Annotated[int, typer.Option(min=1, help='Trials to judge by.')] = 4,
    seconds: Annotated[float, typer.Option(min=10, help='Length of a trial.')] = 12.0,
    epochs: Annotated[int, typer.Option(min=1, help='Epochs of the recurrent stage.')] = 30,
    seeds: Annotated[int, typer.Option(min=1, help='Trainings per row.')] = 2,
    preset: Annotated[str, typer.Option(help='easy, paper_like or hard.')] = 'paper_like',
    json: Annotated[OptionalPath, typer.Option(help='Write the figures there as well.')] = None,
) -> None:
    """Train on labels with unaligned, tapped, refined and perfect clocks; compare the errors."""
    from rich.console import Console
    from rich.progress import Progress
    from rich.table import Table

    with Progress(transient=True) as progress:
        steps = progress.add_task('learning', total=trials + checks + len(LABELS) * seeds)
        figures = measure(
            (trials, checks), seconds, epochs, seeds, preset, lambda: progress.advance(steps)
        )
    table = Table(title=f'FGER-Net on {preset}, simulated', title_justify='left')
    for heading in ('clocks', 'time error of the labels [ms]', 'MAE [N]', 'RMSE [N]'):
        table.add_column(heading, justify='left' if heading == 'clocks' else 'right')
    for name, row in figures.items():
        mae, rmse = np.array(row['mae']), np.array(row['rmse'])
        table.add_row(
            name,
            f'{row["time_error_ms"]:.2f}',
            f'{mae.mean():.4f} +- {mae.std():.4f}',
            f'{rmse.mean():.4f} +- {rmse.std():.4f}',
        )
    Console().print(table)
    if json is not None:
        json.write_text(json_module.dumps(figures, indent=2) + '\n', encoding='utf-8')


def measure(
    counts: tuple[int, int],
    seconds: float,
    epochs: int,
    seeds: int,
    preset: str,
    advance: Callable[[], None],
) -> dict[str, dict[str, float | list[float]]]:
    """Return mean absolute time error [ms], and MAE and RMSE [N] of each training, per kind of map.

    Args:
        counts: Trials to train on and to judge by.
        seconds: Length of a trial [s].
        epochs: Epochs of the recurrent stage.
        seeds: Trainings per row.
        preset: How hard the sensor is.
        advance: Called after each step.
    """
    from mixtac_fger.config import FgerConfig
    from mixtac_fger.dataset import make_sample, true_force

    config = FgerConfig()
    samples: list[Sample] = []
    kept: list[Trial] = []
    for number in range(sum(counts)):
        trial = _trial(number, seconds, preset)
        samples.append(make_sample(config, trial, true_force(trial.truth), {'device_seed': 0}))
        kept.append(trial)
        advance()
    learned, judged = samples[: counts[0]], samples[counts[0] :]
    maps = clock_maps(kept[: counts[0]])
    first = config.reference_frames - 1
    figures: dict[str, dict[str, float | list[float]]] = {}
    for name in LABELS:
        labelled = [
            _relabelled(sample, trial, one, first)
            for sample, trial, one in zip(learned, kept, maps[name], strict=False)
        ]
        errors = []
        for seed in range(seeds):
            errors.append(_train_and_judge(labelled, judged, epochs, seed))
            advance()
        figures[name] = {
            'time_error_ms': float(np.mean([one.error_ms for one in maps[name]])),
            'mae': [mae for mae, _ in errors],
            'rmse': [rmse for _, rmse in errors],
        }
    return figures


def clock_maps(trials: list[Trial]) -> dict[str, list[Map]]:
    """Return the maps of trials of one sensor by the kinds of `LABELS`.

    `none` is the difference of the clocks by host stamps at the start of the trial: the clocks'
    offset, wrong by how long packets take to the host, with the sensor's delay and the drift left
    in. The others are as `mixtac align` on a folder fits them, `perfect` the truth.
    """
    rng = np.random.default_rng(FIRST_SEED)
    maps: dict[str, list[Map]] = {name: [] for name in LABELS}
    alone = [_fit(trial, None) for trial in trials]
    from mixtac_alignment.sensor_pool import pool_sensor

    known = pool_sensor([refined for _, refined in alone])
    for trial in trials:
        first, refined = _fit(trial, known)
        rate, offset_us = trial.clock
        late_us = 1e6 * (rng.uniform(*REFERENCE_HOST_S) - rng.uniform(*HOST_S))
        maps['none'].append(_rated(1.0, offset_us - late_us, trial))
        maps['two_impulse'].append(_rated(*_plain(first), trial))
        maps['refined'].append(_rated(*_plain(refined.fit), trial))
        maps['perfect'].append(_rated(rate, offset_us + trial.reference_delay_us, trial))
    return maps


def _trial(number: int, seconds: float, preset: str) -> Trial:
    from mixtac_sim.presets import preset as named
    from mixtac_sim.trial import simulate_trial

    profile = PROFILES[number % len(PROFILES)]
    seed = FIRST_SEED + number
    return simulate_trial(FIRST_SEED, seed, profile, seconds, sync=True, preset=named(preset))


def _fit(trial: Trial, known: SensorTiming | None) -> tuple[ClockFit, Refinement]:
    from mixtac_alignment.event_history import by_cell
    from mixtac_alignment.frame_features import FrameFeatures, reduce_frame
    from mixtac_alignment.rate_history import EventCounts
    from mixtac_alignment.refinement import refine
    from mixtac_alignment.tap_anchors import fit_taps

    rows, columns = trial.frames.shape[1:]
    values = np.stack([reduce_frame(frame, 1023.0) for frame in trial.frames])
    frames = FrameFeatures(trial.exposure_start_us, trial.exposure_end_us, values)
    force = (trial.reference_t_us.astype(np.float64) * 1e-6, trial.reference_wrench[:, 2])
    settings, lag = (None, None) if known is None else (known.settings, known.lag)
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


def _relabelled(sample: Sample, trial: Trial, clock: Map, first: int) -> Sample:
    """Return a sample with the labels that a clock map gives."""
    from mixtac_fger.dataset import aligned_force

    label: ForceLabel = aligned_force(
        trial.reference_t_us, trial.reference_wrench[:, 2], clock.rate, clock.offset_us
    )
    exposures = label.mean(trial.exposure_start_us, trial.exposure_end_us)
    return replace(sample, force=label.at(sample.window_end_us), frame_force=exposures[first:])


def _train_and_judge(
    learned: list[Sample], judged: list[Sample], epochs: int, seed: int
) -> tuple[float, float]:
    """Return MAE and RMSE [N] on trials that were not trained on."""
    import torch

    from mixtac_fger.batches import stack
    from mixtac_fger.config import FgerConfig
    from mixtac_fger.training import Trainer, estimate
    from mixtac_fger.training_settings import TrainingSettings

    settings = TrainingSettings.from_dict(
        {
            'seed': seed,
            'frame_epochs': max(1, epochs // 2),
            'recurrent_epochs': epochs,
            'joint_epochs': epochs // 6,
        }
    )
    network = Trainer(FgerConfig(), settings).run(stack(learned))
    sequences = stack(judged)
    with torch.no_grad():
        force, _ = estimate(network, sequences)
    error = (force - sequences.force)[sequences.valid]
    if not len(error):
        raise MixtacError('no windows to judge by: give longer trials')
    return float(error.abs().mean()), float(error.square().mean().sqrt())
