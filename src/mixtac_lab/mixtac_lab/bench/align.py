# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Errors of the clock alignment on simulated recordings with known clocks, intact and damaged."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Optional

import numpy as np
import typer

from mixtac_alignment.histories import CellEvents, EventCounts, FrameFeatures, by_cell, reduce_frame
from mixtac_events.errors import MixtacError
from mixtac_sim.world.effects import PRESETS, preset
from mixtac_sim.world.trial import simulate_trial

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_alignment.bags import SensorTiming
    from mixtac_alignment.clock_fit import ClockFit
    from mixtac_alignment.refinement import Refinement


FIRST_SEED: Final = 600_000
"""Nothing was tuned on this seed or a later one."""
PROFILES: Final = ('impact', 'dynamic', 'oscillation', 'press', 'demo')
"""Trials of one sensor; the first of them shows the lag of its gel."""
LENGTH_S: Final = 25.0
"""Of a trial, as in the paper."""
DAMAGES: Final = ('no impulse', 'one impulse', 'clipped', 'double taps', 'event gap', 'clock jump')
ADC_WHITE: Final = 1023.0


@dataclass(frozen=True, slots=True, eq=False)
class TrialRecording:
    """A recording and its true clock map.

    Attributes:
        sensor: Number of the sensor.
        profile: Force profile.
        preset: How hard it is.
        events: Events by cell, camera clock.
        frames: Frames, camera clock.
        force_t_s: Reference stamps, reference clock [s].
        force: Reference force [N].
        taps_s: Synchronising impulses, camera clock [s].
        rate: True rate of the reference clock per camera clock.
        offset_s: Stamp of the reference sample that shows the force of camera time 0 [s]: clock
            offset and delay of the sensor together.
    """

    sensor: int
    profile: str
    preset: str
    events: CellEvents
    frames: FrameFeatures
    force_t_s: NDArray[np.float64]
    force: NDArray[np.float64]
    taps_s: tuple[float, ...]
    rate: float
    offset_s: float

    @property
    def counts(self) -> EventCounts:
        """Return the event counts."""
        return EventCounts.of(self.events.t_us)

    def true_s(self, camera_us: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return camera times [us] on the reference clock [s], in truth."""
        return np.asarray(self.rate * camera_us * 1e-6 + self.offset_s)


def simulate_recording(
    number: int, seconds: float = LENGTH_S, cache: Path | None = None
) -> TrialRecording:
    """Return recording `number` of the benchmark, from a cache where it has been simulated."""
    path = None if cache is None else cache / f'{FIRST_SEED + number}_{seconds:g}s_cells.npz'
    if path is None or not path.exists():
        data = _simulated(number, seconds)
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
            np.savez(path, allow_pickle=False, **data)
    else:
        with np.load(path) as stored:
            data = dict(stored)
    return TrialRecording(
        sensor=number // len(PROFILES),
        profile=PROFILES[number % len(PROFILES)],
        preset=_preset(number),
        events=CellEvents(data['events_us'].astype(np.int64), data['cell'], data['on']),
        frames=FrameFeatures(data['start_us'], data['end_us'], data['values']),
        force_t_s=data['force_t_s'],
        force=data['force'],
        taps_s=tuple(map(float, data['taps_s'])),
        rate=float(data['clock'][0]),
        offset_s=float(data['clock'][1]),
    )


def _preset(number: int) -> str:
    return tuple(PRESETS)[number // len(PROFILES) % len(PRESETS)]


def _simulated(number: int, seconds: float) -> dict[str, NDArray[Any]]:
    trial = simulate_trial(
        FIRST_SEED + number // len(PROFILES),
        FIRST_SEED + number,
        PROFILES[number % len(PROFILES)],
        seconds,
        sync=True,
        preset=preset(_preset(number)),
    )
    rate, offset_us = trial.clock
    events = by_cell(trial.events, 346, 260)
    return {
        'events_us': events.t_us.astype(np.int32),
        'cell': events.cell,
        'on': events.on,
        'start_us': trial.exposure_start_us,
        'end_us': trial.exposure_end_us,
        'values': np.stack([reduce_frame(frame, ADC_WHITE) for frame in trial.frames]),
        'force_t_s': trial.reference_t_us * 1e-6,
        'force': trial.reference_wrench[:, 2],
        'taps_s': np.array(trial.profile.sync_s),
        'clock': np.array([rate, 1e-6 * (offset_us + trial.reference_delay_us)]),
    }


def damage(recording: TrialRecording, kind: str, rng: np.random.Generator) -> TrialRecording:
    """Return a recording with one fault of `DAMAGES`."""
    first, last = recording.taps_s
    if kind == 'no impulse':
        return _cut(recording, first + 0.2, last - 0.2)
    if kind == 'one impulse':
        return _cut(recording, -1.0, last - 0.2)
    if kind == 'clipped':
        limit = rng.uniform(0.2, 0.7) * float(recording.force.max())
        return replace(recording, force=np.minimum(recording.force, limit))
    if kind == 'double taps':
        return _double(recording, float(rng.uniform(0.05, 0.4)))
    if kind == 'event gap':
        near = rng.random() < 0.5
        at = first + rng.uniform(-0.2, 0.0) if near else rng.uniform(first + 1.0, last - 1.0)
        return _gap(recording, float(at))
    jump = float(rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-2.3, -0.3))
    return _jump(recording, float(rng.uniform(first + 2.0, last - 2.0)), jump)


def _cut(recording: TrialRecording, start_s: float, end_s: float) -> TrialRecording:
    """Keep a part of the recording, on both clocks."""
    t, frames = recording.events.t_us * 1e-6, recording.frames
    kept = (frames.start_us * 1e-6 > start_s) & (frames.end_us * 1e-6 < end_s)
    shown = (recording.force_t_s - recording.offset_s) / recording.rate
    inside = (shown > start_s) & (shown < end_s)
    return replace(
        recording,
        events=_only(recording.events, (t > start_s) & (t < end_s)),
        frames=FrameFeatures(frames.start_us[kept], frames.end_us[kept], frames.values[kept]),
        force_t_s=recording.force_t_s[inside],
        force=recording.force[inside],
    )


def _double(recording: TrialRecording, apart_s: float) -> TrialRecording:
    """Repeat what happened at the first tap shortly after it, in both streams."""
    first = recording.taps_s[0]
    all_events = recording.events
    t = all_events.t_us * 1e-6
    tap = _only(all_events, (t > first - 0.03) & (t < first + 0.05))
    times = np.concatenate([all_events.t_us, tap.t_us + round(apart_s * 1e6)])
    cells = np.concatenate([all_events.cell, tap.cell])
    polarity = np.concatenate([all_events.on, tap.on])
    events = _only(CellEvents(times, cells, polarity), np.argsort(times, kind='stable'))
    at = recording.rate * first + recording.offset_s
    source = recording.force_t_s - apart_s
    near = np.abs(source - at) < 0.04
    force = recording.force.copy()
    force[near] += np.interp(source[near], recording.force_t_s, recording.force)
    return replace(recording, events=events, force=force)


def _gap(recording: TrialRecording, at_s: float) -> TrialRecording:
    t = recording.events.t_us * 1e-6
    return replace(recording, events=_only(recording.events, (t < at_s) | (t > at_s + 0.2)))


def _jump(recording: TrialRecording, at_s: float, jump_s: float) -> TrialRecording:
    """Set the camera's clock on or back; what follows keeps its true map from before."""
    jump_us, at_us = round(jump_s * 1e6), round(at_s * 1e6)
    frames = recording.frames
    start, end = (np.where(t > at_us, t + jump_us, t) for t in (frames.start_us, frames.end_us))
    order = np.argsort(start, kind='stable')
    whole = np.flatnonzero(np.diff(start[order], prepend=-1) > 0)
    kept = order[whole]
    kept = kept[end[kept] > start[kept]]
    t_us = recording.events.t_us
    moved = replace(recording.events, t_us=np.where(t_us > at_us, t_us + jump_us, t_us))
    return replace(
        recording,
        events=_only(moved, np.argsort(moved.t_us, kind='stable')),
        frames=FrameFeatures(start[kept], end[kept], frames.values[kept]),
    )


def _only(events: CellEvents, chosen: NDArray[Any]) -> CellEvents:
    return CellEvents(events.t_us[chosen], events.cell[chosen], events.on[chosen])


OptionalPath = Optional[Path]  # noqa: UP045  (typer evaluates this under Python 3.10)
POINTS: Final = 41
"""Times over a trial at which the error is taken."""
WRONG_S: Final = 2e-3
"""A map with a larger error is wrong."""
METHODS: Final = ('paper', 'two_impulse', 'refined', 'two_impulse_pooled', 'refined_pooled')
"""Pooled: with gel and latency of the sensor from all its trials, as `mixtac align` on a folder."""


@dataclass(slots=True)
class Scores:
    """Errors of one method.

    Attributes:
        errors_s: Per trial, time error over the trial [s].
        inside: Per trial, share of these within the stated 95 % interval.
        refused: Trials without a map.
    """

    errors_s: list[NDArray[np.float64]] = field(default_factory=list)
    inside: list[float] = field(default_factory=list)
    refused: int = 0

    def add(self, fit: ClockFit, recording: TrialRecording) -> None:
        """Add the map of a recording."""
        times = _times(recording)
        error = fit.to_reference(times) - recording.true_s(times)
        self.errors_s.append(np.abs(error))
        self.inside.append(float(np.mean(np.abs(error) <= 1.96 * fit.std_at(times))))

    def summary(self) -> dict[str, float]:
        """Return quantiles [ms], coverage and numbers."""
        if not self.errors_s:
            return {'trials': 0, 'refused': self.refused}
        p50, p95 = 1e3 * np.percentile(np.concatenate(self.errors_s), [50, 95])
        return {
            'p50': round(float(p50), 3),
            'p95': round(float(p95), 3),
            'coverage_95': round(float(np.mean(self.inside)), 3),
            'trials': len(self.errors_s),
            'refused': self.refused,
        }


def align(
    trials: Annotated[int, typer.Option(min=1, help='Simulated trials.')] = 200,
    damaged: Annotated[int, typer.Option(min=0, help='Damaged trials.')] = 100,
    seconds: Annotated[float, typer.Option(min=8.0, help='Length of a trial.')] = 25.0,
    cache: Annotated[OptionalPath, typer.Option(help='Folder that keeps the recordings.')] = None,
    report: Annotated[OptionalPath, typer.Option('--json', help='Write the result.')] = None,
) -> None:
    """Measure the error of the clock alignment on simulated trials with known clocks."""
    from rich.console import Console
    from rich.progress import track

    console = Console()
    scores = {name: Scores() for name in METHODS}
    groups: dict[str, Scores] = {}
    faults = DamageScores()
    sensor: list[TrialRecording] = []
    for number in track(range(trials), 'aligning', console=console):
        recording = simulate_recording(number, seconds, cache)
        if sensor and sensor[0].sensor != recording.sensor:
            score_sensor(sensor, scores, groups)
            sensor = []
        sensor.append(recording)
        if number < damaged:
            faults.add(recording, number)
    score_sensor(sensor, scores, groups)
    result = {'seconds': seconds} | summarise(scores, groups, faults)
    console.print_json(data=result)
    if report is not None:
        report.write_text(json.dumps(result, indent=2) + '\n', encoding='utf-8')


def score_sensor(
    recordings: list[TrialRecording], scores: dict[str, Scores], groups: dict[str, Scores]
) -> None:
    """Fit the recordings of a sensor, each alone and with what all of them say of the sensor."""
    from mixtac_alignment.bags import pool_sensor
    from mixtac_alignment.refinement import refine
    from mixtac_alignment.taps import fit_taps

    def fit(each: TrialRecording, suffix: str, known: SensorTiming | None) -> Refinement | None:
        lag, settings = (None, None) if known is None else (known.lag, known.parameters)
        data = (each.frames, each.force_t_s, each.force)
        try:
            first = fit_taps(each.counts, each.events, *data, settings, lag)
        except MixtacError:
            scores[f'two_impulse{suffix}'].refused += 1
            scores[f'refined{suffix}'].refused += 1
            return None
        scores[f'two_impulse{suffix}'].add(first, each)
        try:
            refined = refine(first, *data, lag)
        except MixtacError:
            scores[f'refined{suffix}'].refused += 1
            return None
        scores[f'refined{suffix}'].add(refined.fit, each)
        groups.setdefault(f'refined{suffix} {each.preset}', Scores()).add(refined.fit, each)
        return refined

    found = [fit(each, '', None) for each in recordings]
    known = pool_sensor([refined for refined in found if refined is not None])
    for each in recordings:
        fit(each, '_pooled', known)
        _score_paper(each, scores['paper'])


def _score_paper(recording: TrialRecording, scores: Scores) -> None:
    from mixtac_alignment.two_impulse import fit_counts

    try:
        scores.add(fit_counts(recording.counts, recording.force_t_s, recording.force), recording)
    except MixtacError:
        scores.refused += 1


@dataclass(slots=True)
class DamageScores:
    """What became of damaged recordings, by kind.

    Attributes:
        refused: Refused with a reason.
        right: Solved, within 2 ms over the whole trial.
        wrong: Solved, but not right.
        worst_ms: Largest error of a solved one [ms].
    """

    refused: dict[str, int] = field(default_factory=dict)
    right: dict[str, int] = field(default_factory=dict)
    wrong: dict[str, int] = field(default_factory=dict)
    worst_ms: float = 0.0

    def add(self, recording: TrialRecording, number: int) -> None:
        """Damage a recording in the way whose turn it is, and align it."""
        from mixtac_alignment.align import Recording
        from mixtac_alignment.align import align as align_recording

        kind = DAMAGES[number % len(DAMAGES)]
        try:
            broken = damage(recording, kind, np.random.default_rng(number))
            none = np.zeros(0)
            whole = Recording(
                counts=broken.counts,
                events=broken.events,
                frames=broken.frames,
                force_t_s=broken.force_t_s,
                force=broken.force,
                edges_us=none.astype(np.int64),
                reference_edges_s=none,
            )
            fit, _ = align_recording(whole)
        except MixtacError:
            self.refused[kind] = self.refused.get(kind, 0) + 1
            return
        times = _times(recording)
        worst = float(np.abs(fit.to_reference(times) - recording.true_s(times)).max())
        self.worst_ms = max(self.worst_ms, 1e3 * worst)
        tally = self.right if worst <= WRONG_S else self.wrong
        tally[kind] = tally.get(kind, 0) + 1


def summarise(
    scores: dict[str, Scores], groups: dict[str, Scores], faults: DamageScores
) -> dict[str, Any]:
    """Return the result of the benchmark."""
    result: dict[str, Any] = {f'{name}_ms': each.summary() for name, each in scores.items()}
    result['coverage_95'] = result['refined_ms'].get('coverage_95')
    result['by_preset_ms'] = {name: each.summary() for name, each in groups.items()}
    result['silently_wrong'] = sum(faults.wrong.values())
    result['damaged'] = {
        'refused': faults.refused,
        'right': faults.right,
        'wrong': faults.wrong,
        'worst_ms': round(faults.worst_ms, 3),
    }
    return result


def _times(recording: TrialRecording) -> NDArray[np.int64]:
    return np.linspace(recording.events.t_us[0], recording.events.t_us[-1], POINTS).astype(np.int64)
