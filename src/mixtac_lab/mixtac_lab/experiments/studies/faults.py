# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Whether the force says when it cannot be trusted: after faults, at pressed starts, and without.

The live estimator runs on simulated trials of sensors that no threshold was set with. Every trial
is a piece of work of its own, so that a run of hours goes on where it was cut off.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console
from scipy.ndimage import binary_dilation

from mixtac_cli.figures import make_table
from mixtac_cli.options import JsonFile, ModelName
from mixtac_fger.estimator import Estimate, open_estimator
from mixtac_fger.reasons import Reason
from mixtac_fger.reference import TareError
from mixtac_fger.streaming import ForceEstimator
from mixtac_fger.weights import DEFAULT_MODEL, Model, find_model, read_model
from mixtac_lab.experiments.studies.stream_faults import SEEN, UNSEEN, Stream, stream_of
from mixtac_lab.store import Piece, Store, code_version, files_version
from mixtac_learning.judge.metrics import CalibrationError, fit_scale
from mixtac_learning.trials.simulated import SimulatedSource
from mixtac_learning.trials.trial import TrialArrays
from mixtac_node.files import write_json
from mixtac_recordings.messages import left_aligned
from mixtac_sim.world.training_trials import TrialSpec, simulator_digest

AT_MOST_N = 0.1
"""Error of a valid force that needs no deviation to cover it."""
COVERED = 1.96
"""Deviations that cover an error."""
FIRST_SEED = 880_000
"""First seed of sensors and trials: beyond those of training, evaluation and thresholds."""
PRESETS = ('paper_like', 'easy', 'hard')
GOOD = (
    *('dynamic', 'press', 'oscillation', 'static', 'weights', 'touch', 'idle'),
    *('slide', 'torsion', 'roll', 'handling', 'knocks', 'impact', 'vibration'),
)
"""Profiles of trials without a fault."""
GOOD_S = 30.0
"""Length of a trial without a fault [s]."""
AROUND = 10
"""Windows before and after a wrong force in which no other is right: one that vibrates passes the
true one now and then."""


@dataclass(slots=True)
class Run:
    """Estimates of a stream; T windows.

    Attributes:
        end_us: End of each window, camera clock [us], int64 [T].
        force: Estimate [N], float64 [T].
        deviation: Its standard deviation [N], float64 [T].
        reason: Number of the `Reason`, int64 [T].
    """

    end_us: NDArray[np.int64]
    force: NDArray[np.float64]
    deviation: NDArray[np.float64]
    reason: NDArray[np.int64]

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Which forces are valid."""
        return np.asarray(self.reason == Reason.TRUSTED)


def follow(model: Model, stream: Stream, *, from_us: int = 0, tare_us: int = 0) -> Run:
    """Run the live estimator on a stream.

    Args:
        model: Content of a weight file.
        stream: What arrives.
        from_us: The estimator starts here; other than 0 without the assumption of no contact.
        tare_us: When to tare; 0 for never.

    Raises:
        TareError: The tare was refused.
    """
    opened = open_estimator(model)
    estimator = ForceEstimator(opened, assume_free=not from_us)
    width = opened.window_us
    ends = np.arange(from_us // width * width + width, int(stream.arrival_us[-1]), width)
    cuts = np.searchsorted(stream.events.t, [ends[0] - width, *ends])
    frame = int(np.searchsorted(stream.arrival_us, from_us))
    rows: list[Estimate] = []
    for index, end in enumerate(ends.tolist()):
        while frame < len(stream.frames) and stream.arrival_us[frame] <= end:
            image = stream.frames[frame]
            if image is not None:
                estimator.push_frame(left_aligned(image), int(stream.mid_us[frame]))
            frame += 1
        rows += estimator.push_events(stream.events[cuts[index] : cuts[index + 1]], end)
        if tare_us and end - width < tare_us <= end:
            estimator.tare()
    table = [(each.end_us, each.force, each.deviation or 0.0, int(each.reason)) for each in rows]
    columns = np.array(table, np.float64).reshape(-1, 4).T
    return Run(columns[0].astype(np.int64), columns[1], columns[2], columns[3].astype(np.int64))


def _reasons(run: Run, chosen: NDArray[np.bool_]) -> dict[str, int]:
    return dict(Counter(Reason(int(each)).name for each in run.reason[chosen]))


def judge_faults(_: Path, weights: Path, spec: TrialSpec, other: TrialSpec) -> dict[str, Any]:
    """Put every fault into one trial, from two fifths of it on.

    Errors are differences from the same window without the fault: what the model errs without one
    is no fault's.

    Args:
        weights: Weight file.
        spec: The trial.
        other: Trial of another sensor, for faults that mix two.

    Returns:
        By fault `seconds` to the first force that is not valid (0 where none changes by more than
        `AT_MOST_N`, None for never), `worst` change of a valid force [N], `uncovered` the same
        where the deviation does not cover it, and `reasons`.
    """
    model = read_model(weights)
    trial, theirs = SimulatedSource(spec).load(), SimulatedSource(other).load()
    begin_us = int(trial.arrival_us[-1]) * 2 // 5
    seed = spec.trial_seed
    whole = follow(model, stream_of(trial, begin_us, theirs, seed))
    scale = fit_scale(whole.force, trial.label().at(whole.end_us).astype(np.float64))
    found = {}
    for name, fault in {**SEEN, **UNSEEN}.items():
        stream = stream_of(trial, begin_us, theirs, seed)
        fault(stream)
        run = follow(model, stream)
        change = scale * np.abs(run.force - np.interp(run.end_us, whole.end_us, whole.force))
        after = run.end_us > begin_us
        late = run.end_us[after & ~run.valid]
        seconds = 1e-6 * float(late[0] - begin_us) if len(late) else None
        if seconds is None and change[after].max(initial=0.0) < AT_MOST_N:
            seconds = 0.0
        trusted = after & run.valid
        error = change[trusted]
        excess = error - COVERED * scale * run.deviation[trusted]
        found[name] = {
            'seconds': seconds,
            'worst': float(error.max(initial=0.0)),
            'uncovered': float(np.minimum(error, excess + AT_MOST_N).max(initial=0.0)),
            'reasons': sorted(_reasons(run, after & ~run.valid)),
        }
    return found


def fault_row(name: str, found: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return the row of a fault.

    Args:
        name: Name of the fault.
        found: Its result on each sensor, from `judge_faults`.
    """
    seconds = [each['seconds'] for each in found]
    return {
        'fault': name,
        'seen': name in SEEN,
        'seconds_to_invalid': None if None in seconds else max(seconds),
        'worst_error_valid_n': round(max(each['worst'] for each in found), 4),
        'worst_uncovered_n': round(max(each['uncovered'] for each in found), 4),
        'undetected': seconds.count(None),
        'trials': len(found),
        'reasons': sorted({reason for each in found for reason in each['reasons']}),
    }


def judge_good(_: Path, weights: Path, spec: TrialSpec) -> dict[str, Any]:
    """Follow a trial without a fault.

    Args:
        weights: Weight file.
        spec: The trial.

    Returns:
        `windows`; how many are `invalid`, but for real saturation; how many of these `rightly`,
        because the force is wrong by more than `AT_MOST_N` and than its deviation covers, or is so
        up to `AROUND` windows from there; and the number of windows by `reasons`.
    """
    trial = SimulatedSource(spec).load()
    run = follow(read_model(weights), stream_of(trial, 0, trial))
    truth = trial.label().at(run.end_us).astype(np.float64)
    try:
        scale = fit_scale(run.force, truth)
    except CalibrationError:
        scale = 1.0
    error = np.abs(scale * run.force - truth)
    wrong = error > np.maximum(AT_MOST_N, COVERED * scale * run.deviation)
    wrong = binary_dilation(wrong, iterations=AROUND)
    invalid = ~run.valid & (run.reason != Reason.SATURATED)
    return {
        'windows': len(run.end_us),
        'invalid': int(invalid.sum()),
        'rightly': int((invalid & wrong).sum()),
        'reasons': _reasons(run, invalid),
    }


def false_alarms(found: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return how often forces of trials without a fault are not valid, from `judge_good`.

    Falsely, where the force was right; `rightly`, where it was not.
    """
    hours = sum(each['windows'] for each in found) * 2e-3 / 3600.0
    rightly = sum(each['rightly'] for each in found)
    falsely = sum(each['invalid'] for each in found) - rightly
    reasons = sum((Counter(each['reasons']) for each in found), Counter())
    return {
        'false_invalid_per_hour': falsely / hours,
        'false_invalid_minutes_in_ten_hours': falsely * 2e-3 / 60.0 / hours * 10.0,
        'rightly_invalid_per_hour': rightly / hours,
        'invalid_trials': sum(each['invalid'] > 0 for each in found),
        'invalid_reasons': dict(reasons),
        'hours_without_fault': hours,
    }


def judge_start(_: Path, weights: Path, spec: TrialSpec) -> dict[str, int]:
    """Start the estimator, and tare it, while the sensor is pressed with 0.1 N or more.

    Args:
        weights: Weight file.
        spec: A trial with a hold; without one, all counts are 0.

    Returns:
        Counts: `starts`, `forces_valid` after them, `tares`, `tares_accepted`.
    """
    counts = dict.fromkeys(('starts', 'forces_valid', 'tares', 'tares_accepted'), 0)
    model, trial = read_model(weights), SimulatedSource(spec).load()
    middle = (trial.exposure_start_us + trial.exposure_end_us) // 2
    at_us = _held(trial, trial.label().at(middle).astype(np.float64))
    if at_us is None:
        return counts
    stream = stream_of(trial, 0, trial)
    counts['starts'] += 1
    run = follow(model, stream, from_us=at_us - 200_000)
    counts['forces_valid'] += int(run.valid.sum())
    for from_us in (0, at_us - 200_000):
        counts['tares'] += 1
        try:
            follow(model, stream, from_us=from_us, tare_us=at_us + 200_000)
        except TareError:
            continue
        counts['tares_accepted'] += 1
    return counts


def _held(trial: TrialArrays, force: NDArray[np.float64]) -> int | None:
    """Return the arrival of a frame in the middle of a hold [us], given the force at each frame."""
    held = [
        int(trial.arrival_us[k])
        for k in range(10, len(force) - 20)
        if force[k - 6 : k + 12].min() > AT_MOST_N and np.ptp(force[k - 6 : k + 12]) < 0.02
    ]
    return held[len(held) // 2] if held else None


def _specs(profiles: Sequence[str], count: int, seconds: float, first: int) -> list[TrialSpec]:
    return [
        TrialSpec(
            first + k, first + k, profiles[k % len(profiles)], seconds, PRESETS[k % len(PRESETS)]
        )
        for k in range(count)
    ]


def faults(
    model: ModelName = DEFAULT_MODEL,
    quick: Annotated[
        bool, typer.Option('--quick', help='All faults, on two sensors; fewer other trials.')
    ] = False,
    hours: Annotated[
        float | None,
        typer.Option(min=0.0, help='Hours without a fault; 10 by default, with --quick a minute.'),
    ] = None,
    out: Annotated[
        Path, typer.Option(help='Folder of results; an interrupted run continues there.')
    ] = Path('runs/faults'),
    jobs: Annotated[int, typer.Option(min=1, help='Number of processes.')] = 2,
    json: JsonFile = None,
) -> None:
    """Show how soon a force says that it cannot be trusted, and how often it says so wrongly."""
    weights = find_model(model)
    packages = ('mixtac_events', 'mixtac_fger', 'mixtac_learning', 'mixtac_recordings')
    code = code_version(*packages, stream_of.__module__)
    version = f'{simulator_digest()} {code} {files_version([weights])}'
    sensors, seconds, starts = (2, 5.0, 3) if quick else (6, 12.0, 50)
    trials = _specs(['dynamic'], sensors, seconds, FIRST_SEED)
    if hours is None:
        hours = 1.0 / 60.0 if quick else 10.0
    good = _specs(GOOD, max(1, round(3600.0 * hours / GOOD_S)), GOOD_S, FIRST_SEED + 4000)
    held = _specs(['long_term'], starts, 5.0, FIRST_SEED + 3000)
    pieces = [
        *(
            Piece('faults', judge_faults, (weights, each, trials[k - 1]), version)
            for k, each in enumerate(trials)
        ),
        *(Piece('start', judge_start, (weights, each), version) for each in held),
        *(Piece('good', judge_good, (weights, each), version) for each in good),
    ]
    console, title = Console(markup=False), 'faults, starts, trials without a fault'
    found = Store(out).run_shown(title, pieces, console, jobs)
    by_sensor, begun = found[:sensors], found[sensors : sensors + starts]
    alarms = false_alarms(found[-len(good) :])
    rows = [fault_row(name, [each[name] for each in by_sensor]) for name in {**SEEN, **UNSEEN}]
    pressed = {name: sum(each[name] for each in begun) for name in begun[0]}
    shown = [
        (
            row['fault'] + ('' if row['seen'] else ' *'),
            'never' if row['seconds_to_invalid'] is None else f'{row["seconds_to_invalid"]:.2f}',
            f'{row["worst_error_valid_n"]:.3f}',
            f'{row["worst_uncovered_n"]:.3f}',
            ', '.join(row['reasons']),
        )
        for row in rows
    ]
    headings = (
        'fault (* not known before)',
        'invalid after [s]',
        'worst valid [N]',
        'not covered [N]',
        'reasons',
    )
    console.print(make_table('faults, simulated', headings, shown))
    console.print({**alarms, **pressed})
    result = {'model': str(weights), 'quick': quick, **alarms, 'pressed': pressed}
    write_json(json, {**result, 'rows': rows})
