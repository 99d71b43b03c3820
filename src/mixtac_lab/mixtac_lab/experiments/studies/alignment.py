# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Effect of clock errors in the labels: the command `experiments alignment`.

FGER-Net is trained on the same simulated trials of one sensor, from the same initial weights,
with reference labels on clocks that are aligned in different ways, from not at all to the true
map. It is tested against the true force on other days of that sensor.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
import torch
import typer
from rich.console import Console
from rich.table import Table

from mixtac_alignment.bags import SensorTiming, pool_sensor
from mixtac_alignment.clock_fit import ClockFit
from mixtac_alignment.refinement import Refinement
from mixtac_cli.figures import make_table
from mixtac_cli.options import JsonFile, Preset
from mixtac_events.errors import MixtacError
from mixtac_fger.config import FgerConfig
from mixtac_lab.bench.align import TrialRecording, fit_impulses, fit_refined
from mixtac_lab.experiments.sizes import PRESET
from mixtac_lab.experiments.training import learning_version
from mixtac_lab.store import Piece, Store, code_version
from mixtac_learning.train.batches import MemoryGroups, stack
from mixtac_learning.train.config import TrainingSettings
from mixtac_learning.train.stages import estimate, train_fger
from mixtac_learning.trials.samples import Sample, make_sample
from mixtac_learning.trials.simulated import arrays_of
from mixtac_learning.trials.trial import aligned_force
from mixtac_node.files import write_json
from mixtac_sim.world.effects import preset as named_preset
from mixtac_sim.world.trial import Trial, simulate_trial

LABELS: Final = ('raw', 'arrival', 'two_impulse', 'refined', 'perfect')
HOST_S: Final = (1e-3, 8e-3)
"""Time from the first event to its arrival at the host: packets of 1 to 8 ms."""
REFERENCE_HOST_S: Final = (1e-4, 1e-3)
"""The same for a sample of the reference sensor."""
FIRST_SEED: Final = 620_000
PROFILES: Final = ('dynamic', 'oscillation', 'impact', 'demo')


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
        seed: Seed of the transmission times of packets.

    `raw` assumes that both clocks are equal. `arrival` takes the difference of the times at which
    the host received the first data: the offset of the clocks, with the error of the transmission
    times, the delay of the sensor and the drift. `two_impulse` and `refined` are fitted as by
    `mixtac align` on a folder, `perfect` is the truth.
    """
    rng = np.random.default_rng(seed)
    maps: dict[str, list[Map]] = {name: [] for name in LABELS}
    alone = [_fit(trial, None) for trial in trials]
    known = pool_sensor([refined for _, refined in alone])
    for trial in trials:
        first, refined = _fit(trial, known)
        rate, offset_us = trial.clock
        late_us = 1e6 * (rng.uniform(*REFERENCE_HOST_S) - rng.uniform(*HOST_S))
        clocks = (
            (1.0, 0.0),
            (1.0, offset_us - late_us),
            *((fit.a, 1e6 * fit.paper_offset_s) for fit in (first, refined.fit)),
            (rate, offset_us + trial.reference_delay_us),
        )
        for name, clock in zip(LABELS, clocks, strict=True):
            maps[name].append(_rated(*clock, trial))
    return maps


def _fit(trial: Trial, known: SensorTiming | None) -> tuple[ClockFit, Refinement]:
    recording = TrialRecording.of(trial)
    first = fit_impulses(recording, known)
    return first, fit_refined(recording, first, known)


def _rated(rate: float, offset_us: float, trial: Trial) -> Map:
    t_us = np.linspace(0.0, float(trial.events.t[-1]), 41)
    true_us = trial.clock[0] * t_us + trial.clock[1] + trial.reference_delay_us
    error = np.abs(rate * t_us + offset_us - true_us)
    return Map(rate, offset_us, 1e-3 * float(error.mean()))


def alignment(
    trials: Annotated[int, typer.Option(min=4, help='Number of training trials.')] = 16,
    checks: Annotated[int, typer.Option(min=1, help='Number of test trials.')] = 4,
    seconds: Annotated[float, typer.Option(min=10, help='Length of a trial (s).')] = 12.0,
    epochs: Annotated[int, typer.Option(min=1, help='Epochs of the recurrent stage.')] = 30,
    seeds: Annotated[int, typer.Option(min=1, help='Number of trainings per kind of clock.')] = 2,
    preset: Preset = PRESET,
    out: Annotated[
        Path, typer.Option(help='Folder for finished trainings; an interrupted run continues.')
    ] = Path('runs/alignment'),
    json: JsonFile = None,
) -> None:
    """Train on labels with raw, coarse, tapped, refined and perfect clocks; compare the errors."""
    version = f'{learning_version()} {code_version(TrialRecording.__module__)}'
    settings = (trials, checks, seconds, epochs, preset)
    cases = [(name, seed) for seed in range(seeds) for name in LABELS]
    pieces = [
        Piece(f'clocks_{n}_s{k}', train_and_test, (n, k, *settings), version) for n, k in cases
    ]
    console = Console(markup=False)
    results = Store(out).run_shown('learning', pieces, console)
    figures: dict[str, Any] = {name: {'trainings': {}} for name in LABELS}
    for (name, seed), found in zip(cases, results, strict=True):
        figures[name]['time_error_ms'] = found.pop('time_error_ms')
        figures[name]['trainings'][str(seed)] = found
    names = ('trials', 'checks', 'seconds', 'epochs', 'preset')
    plan = dict(zip(names, settings, strict=True)) | {'seeds': seeds}
    console.print(_table(plan, figures))
    write_json(json, {'plan': plan, 'figures': figures})


def train_and_test(
    _base: Path,
    label: str,
    seed: int,
    trials: int,
    checks: int,
    seconds: float,
    epochs: int,
    preset: str,
) -> dict[str, Any]:
    """Return the errors of one training; a piece of work.

    Args:
        label: Kind of clock, one of `LABELS`.
        seed: Seed of the initial weights and the order.
        trials: Number of training trials.
        checks: Number of test trials.
        seconds: Length of a trial [s].
        epochs: Epochs of the recurrent stage; the frame stage takes half as many, the joint stage
            a sixth.
        preset: Difficulty preset of the sensor.

    Returns:
        Mean absolute error of the clock in the labels, `time_error_ms`; `mae` and `rmse` [N] on
        trials without training, and `rmse_by_profile`.
    """
    learned, tested, simulated = _samples(trials, checks, seconds, preset)
    maps = clock_maps(list(simulated), FIRST_SEED)[label]
    labelled = [_relabelled(*each) for each in zip(learned, simulated, maps, strict=True)]
    settings = TrainingSettings(
        seed=seed,
        frame_epochs=max(1, epochs // 2),
        recurrent_epochs=epochs,
        joint_epochs=epochs // 6,
        # The uncertainty is not tested.
        deviation_epochs=0,
    )
    network, _ = train_fger(FgerConfig(), settings, MemoryGroups(stack(labelled)))
    sequences = stack(list(tested))
    with torch.no_grad():
        force, _ = estimate(network, sequences)
    error = torch.where(sequences.valid, force - sequences.force, 0.0)
    windows = sequences.valid.sum(dim=0)
    if int(windows.min()) == 0:
        raise MixtacError(f'trials of {seconds:g} s leave no windows to test', remedy='take longer')
    square = error.square().sum(dim=0)
    return {
        'time_error_ms': float(np.mean([one.error_ms for one in maps])),
        'mae': float(error.abs().sum() / windows.sum()),
        'rmse': float((square.sum() / windows.sum()).sqrt()),
        'rmse_by_profile': {
            PROFILES[k]: float((square[at].sum() / windows[at].sum()).sqrt())
            for k in range(len(PROFILES))
            if (at := [i for i in range(checks) if (trials + i) % len(PROFILES) == k])
        },
    }


@functools.lru_cache(maxsize=1)
def _samples(
    trials: int, checks: int, seconds: float, preset: str
) -> tuple[tuple[Sample, ...], tuple[Sample, ...], tuple[Trial, ...]]:
    """Return samples with the true force for training and for tests, and the training trials."""
    samples: list[Sample] = []
    simulated: list[Trial] = []
    for number in range(trials + checks):
        profile = PROFILES[number % len(PROFILES)]
        trial = simulate_trial(
            FIRST_SEED,
            FIRST_SEED + number,
            profile,
            seconds,
            sync=True,
            preset=named_preset(preset),
        )
        origin = {'device_seed': 0}
        arrays = arrays_of(trial, origin)
        samples.append(make_sample(FgerConfig(), arrays, arrays.label(), origin))
        if number < trials:
            simulated.append(trial)
    return tuple(samples[:trials]), tuple(samples[trials:]), tuple(simulated)


def _relabelled(sample: Sample, trial: Trial, clock: Map) -> Sample:
    """Return a sample with the labels of a clock map."""
    first = FgerConfig().reference_frames - 1
    label = aligned_force(
        trial.reference_t_us, trial.reference_wrench[:, 2], clock.rate, clock.offset_us
    )
    exposures = label.mean(trial.exposure_start_us, trial.exposure_end_us)
    return replace(sample, force=label.at(sample.window_end_us), frame_force=exposures[first:])


def _table(plan: dict[str, Any], figures: dict[str, Any]) -> Table:
    title = (
        f'FGER-Net on {plan["preset"]}, simulated: {plan["trials"]} trials of'
        f' {plan["seconds"]:g} s, {plan["epochs"]} epochs, {plan["seeds"]} trainings'
    )
    rows = []
    for name, row in figures.items():
        runs = list(row['trainings'].values())
        cells = [[run[key] for run in runs] for key in ('mae', 'rmse')]
        cells += [[r['rmse_by_profile'].get(p, np.nan) for r in runs] for p in PROFILES]
        shown = (f'{np.mean(cell):.4f} +- {np.std(cell):.4f}' for cell in cells)
        rows.append((name, f'{row["time_error_ms"]:.2f}', *shown))
    headings = ('time error [ms]', 'MAE [N]', 'RMSE [N]', *(f'{p} RMSE' for p in PROFILES))
    return make_table(title, ('clocks', *headings), rows)
