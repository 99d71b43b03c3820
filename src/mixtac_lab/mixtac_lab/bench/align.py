# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Errors of the clock alignment on simulated recordings with known clocks, intact and damaged."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track

from mixtac_alignment.align import Recording
from mixtac_alignment.align import align as align_recording
from mixtac_alignment.bags import SensorTiming, pool_sensor
from mixtac_alignment.clock_fit import ClockFit
from mixtac_alignment.histories import CellEvents, EventCounts, FrameFeatures, by_cell, reduce_frame
from mixtac_alignment.parameters import DEFAULTS
from mixtac_alignment.refinement import Refinement, refine
from mixtac_alignment.taps import fit_taps
from mixtac_alignment.two_impulse import fit_counts
from mixtac_cli.options import JsonFile, OptionalPath
from mixtac_events.errors import MixtacError
from mixtac_lab.store import Piece, Store, code_version
from mixtac_node.files import write_json
from mixtac_sim.world.effects import preset
from mixtac_sim.world.training_trials import simulator_digest
from mixtac_sim.world.trial import Trial, simulate_trial

FIRST_SEED: Final = 600_000
"""Nothing was tuned on this seed or a later one."""
PROFILES: Final = ('impact', 'dynamic', 'oscillation', 'press', 'demo')
"""Trials of one sensor; the first of them shows the lag of its gel."""
LENGTH_S: Final = 25.0
"""Length of a trial, as in the paper [s]."""
DAMAGES: Final = ('no impulse', 'one impulse', 'clipped', 'double taps', 'event gap', 'clock jump')
ADC_WHITE: Final = 1023.0
POINTS: Final = 41
"""Number of times in a trial at which the error is taken."""
WRONG_S: Final = 2e-3
"""A clock map with a larger error is wrong [s]."""
METHODS: Final = ('paper', 'two_impulse', 'refined', 'two_impulse_pooled', 'refined_pooled')
"""Pooled: with gel and latency of the sensor from all its trials, as `mixtac align` on a folder."""


@dataclass(frozen=True, slots=True, eq=False)
class TrialRecording:
    """A recording and its true clock map.

    Attributes:
        events: Events by cell, camera clock.
        frames: Frames, camera clock.
        force_t_s: Reference stamps, reference clock [s].
        force: Reference force [N].
        taps_s: Synchronising impulses, camera clock [s].
        rate: True rate of the reference clock per camera clock.
        offset_s: Stamp of the reference sample that shows the force of camera time 0 [s]: clock
            offset and delay of the sensor together.
    """

    events: CellEvents
    frames: FrameFeatures
    force_t_s: NDArray[np.float64]
    force: NDArray[np.float64]
    taps_s: tuple[float, ...]
    rate: float
    offset_s: float

    @classmethod
    def of(cls, trial: Trial) -> TrialRecording:
        """Return the recording of a simulated trial."""
        rows, columns = trial.frames.shape[1:]
        values = np.stack([reduce_frame(frame, ADC_WHITE) for frame in trial.frames])
        rate, offset_us = trial.clock
        return cls(
            events=by_cell(trial.events, columns, rows),
            frames=FrameFeatures(trial.exposure_start_us, trial.exposure_end_us, values),
            force_t_s=np.asarray(trial.reference_t_us * 1e-6, np.float64),
            force=trial.reference_wrench[:, 2],
            taps_s=tuple(trial.profile.sync_s),
            rate=rate,
            offset_s=1e-6 * (offset_us + trial.reference_delay_us),
        )

    @classmethod
    def load(cls, path: Path) -> TrialRecording:
        """Read what `save` wrote."""
        with np.load(path) as stored:
            data = dict(stored)
        return cls(
            events=CellEvents(data['events_us'].astype(np.int64), data['cell'], data['on']),
            frames=FrameFeatures(data['start_us'], data['end_us'], data['values']),
            force_t_s=data['force_t_s'],
            force=data['force'],
            taps_s=tuple(map(float, data['taps_s'])),
            rate=float(data['clock'][0]),
            offset_s=float(data['clock'][1]),
        )

    def save(self, path: Path) -> None:
        """Write the recording to an npz file."""
        np.savez(
            path,
            allow_pickle=False,
            events_us=self.events.t_us.astype(np.int32),
            cell=self.events.cell,
            on=self.events.on,
            start_us=self.frames.start_us,
            end_us=self.frames.end_us,
            values=self.frames.values,
            force_t_s=self.force_t_s,
            force=self.force,
            taps_s=np.array(self.taps_s),
            clock=np.array([self.rate, self.offset_s]),
        )

    @property
    def counts(self) -> EventCounts:
        """Return the event counts."""
        return EventCounts.of(self.events.t_us)

    def true_s(self, camera_us: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return camera times [us] on the reference clock [s] by the true map."""
        return np.asarray(self.rate * camera_us * 1e-6 + self.offset_s)


def simulate_recording(number: int, seconds: float, store: Store) -> TrialRecording:
    """Return recording `number` of the benchmark, simulated if the store does not hold it."""
    version = f'{simulator_digest()} {code_version("mixtac_alignment.histories")}'
    name = f'recording_{FIRST_SEED + number}'
    piece = Piece(name, _simulated, (number, seconds), version)
    store.run([piece])
    return TrialRecording.load(store.path(piece, '.npz'))


def _simulated(base: Path, number: int, seconds: float) -> dict[str, Any]:
    trial = simulate_trial(
        FIRST_SEED + sensor_of(number),
        FIRST_SEED + number,
        PROFILES[number % len(PROFILES)],
        seconds,
        sync=True,
        preset=preset(preset_of(number)),
    )
    TrialRecording.of(trial).save(base.with_name(f'{base.name}.npz'))
    return {'seconds': seconds}


def sensor_of(number: int) -> int:
    """Return the number of the sensor of a recording."""
    return number // len(PROFILES)


JUDGED_PRESETS = ('easy', 'paper_like', 'hard')


def preset_of(number: int) -> str:
    """Return the difficulty preset of a recording."""
    return JUDGED_PRESETS[sensor_of(number) % len(JUDGED_PRESETS)]


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
    frames = recording.frames
    kept = (frames.start_us * 1e-6 > start_s) & (frames.end_us * 1e-6 < end_s)
    shown = (recording.force_t_s - recording.offset_s) / recording.rate
    inside = (shown > start_s) & (shown < end_s)
    return replace(
        recording,
        events=recording.events.between(round(1e6 * start_s), round(1e6 * end_s)),
        frames=FrameFeatures(frames.start_us[kept], frames.end_us[kept], frames.values[kept]),
        force_t_s=recording.force_t_s[inside],
        force=recording.force[inside],
    )


def _double(recording: TrialRecording, apart_s: float) -> TrialRecording:
    """Repeat the first tap shortly after it, in both streams."""
    first = recording.taps_s[0]
    whole = recording.events
    tap = whole.between(round(1e6 * (first - 0.03)), round(1e6 * (first + 0.05)))
    times = np.concatenate([whole.t_us, tap.t_us + round(apart_s * 1e6)])
    cells = np.concatenate([whole.cell, tap.cell])
    polarity = np.concatenate([whole.on, tap.on])
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
    """Set the camera clock forward or back; the true map stays that from before the jump."""
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


@dataclass(slots=True)
class Scores:
    """Errors of one method.

    Attributes:
        errors_s: Time errors of each trial [s].
        inside: Share of them within the stated 95 % interval, for each trial.
        refused: Number of trials without a clock map.
    """

    errors_s: list[NDArray[np.float64]] = field(default_factory=list)
    inside: list[float] = field(default_factory=list)
    refused: int = 0

    def add(self, fit: ClockFit, recording: TrialRecording) -> None:
        """Add the clock map of a recording."""
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
    trials: Annotated[int, typer.Option(min=1, help='Number of simulated trials.')] = 200,
    damaged: Annotated[int, typer.Option(min=0, help='Number of damaged trials.')] = 100,
    seconds: Annotated[float, typer.Option(min=8.0, help='Length of a trial (s).')] = LENGTH_S,
    cache: Annotated[OptionalPath, typer.Option(help='Folder for simulated recordings.')] = None,
    report: JsonFile = None,
) -> None:
    """Measure the error of the clock alignment on simulated trials with known clocks."""
    console, store = Console(markup=False), Store(cache)
    scores = {name: Scores() for name in METHODS}
    groups: dict[str, Scores] = {}
    faults = DamageScores()
    sensor: list[TrialRecording] = []
    for number in track(range(trials), 'aligning', console=console):
        recording = simulate_recording(number, seconds, store)
        if number % len(PROFILES) == 0 and sensor:
            score_sensor(sensor, preset_of(number - 1), scores, groups)
            sensor = []
        sensor.append(recording)
        if number < damaged:
            faults.add(recording, number)
    score_sensor(sensor, preset_of(trials - 1), scores, groups)
    result = {'seconds': seconds} | summarise(scores, groups, faults)
    console.print_json(data=result)
    write_json(report, result)


def score_sensor(
    recordings: list[TrialRecording],
    preset_name: str,
    scores: dict[str, Scores],
    groups: dict[str, Scores],
) -> None:
    """Fit the recordings of a sensor, each alone and with the pooled timing of the sensor.

    Args:
        recordings: Recordings of one sensor.
        preset_name: Its difficulty preset.
        scores: Scores by method; added to.
        groups: Scores of the refined methods by preset; added to.
    """

    def fit(each: TrialRecording, suffix: str, known: SensorTiming | None) -> Refinement | None:
        two_impulse, refined = (scores[f'{name}{suffix}'] for name in ('two_impulse', 'refined'))
        try:
            first = fit_impulses(each, known)
        except MixtacError:
            two_impulse.refused += 1
            refined.refused += 1
            return None
        two_impulse.add(first, each)
        try:
            better = fit_refined(each, first, known)
        except MixtacError:
            refined.refused += 1
            return None
        refined.add(better.fit, each)
        groups.setdefault(f'refined{suffix} {preset_name}', Scores()).add(better.fit, each)
        return better

    found = [fit(each, '', None) for each in recordings]
    known = pool_sensor([refined for refined in found if refined is not None])
    for each in recordings:
        fit(each, '_pooled', known)
        try:
            scores['paper'].add(fit_counts(each.counts, each.force_t_s, each.force), each)
        except MixtacError:
            scores['paper'].refused += 1


def fit_impulses(recording: TrialRecording, known: SensorTiming | None) -> ClockFit:
    """Return the clock map from the impulses.

    Args:
        recording: The recording.
        known: Timing of the sensor from other recordings; None for none.

    Raises:
        AlignmentError: The impulses cannot be found or paired.
    """
    lag, settings = (None, DEFAULTS) if known is None else (known.lag, known.parameters)
    force = (recording.force_t_s, recording.force)
    return fit_taps(recording.counts, recording.events, recording.frames, *force, settings, lag)


def fit_refined(
    recording: TrialRecording, first: ClockFit, known: SensorTiming | None
) -> Refinement:
    """Return the refined clock map; arguments and errors as for `fit_impulses`."""
    lag = None if known is None else known.lag
    return refine(first, recording.frames, recording.force_t_s, recording.force, lag)


@dataclass(slots=True)
class DamageScores:
    """Results on damaged recordings.

    Attributes:
        numbers: By result and kind of damage: `refused` with a reason, `right`, solved with at most
            2 ms of error over the whole trial, or `wrong`, solved with a larger error.
        worst_ms: Largest error of a solved recording [ms].
    """

    numbers: dict[str, Counter[str]] = field(
        default_factory=lambda: {name: Counter() for name in ('refused', 'right', 'wrong')}
    )
    worst_ms: float = 0.0

    def add(self, recording: TrialRecording, number: int) -> None:
        """Damage a recording in the way given by its number, and align it."""
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
            self.numbers['refused'][kind] += 1
            return
        times = _times(recording)
        worst = float(np.abs(fit.to_reference(times) - recording.true_s(times)).max())
        self.worst_ms = max(self.worst_ms, 1e3 * worst)
        self.numbers['right' if worst <= WRONG_S else 'wrong'][kind] += 1


def summarise(
    scores: dict[str, Scores], groups: dict[str, Scores], faults: DamageScores
) -> dict[str, Any]:
    """Return the result of the benchmark."""
    result: dict[str, Any] = {f'{name}_ms': each.summary() for name, each in scores.items()}
    result['coverage_95'] = result['refined_ms'].get('coverage_95')
    result['by_preset_ms'] = {name: each.summary() for name, each in groups.items()}
    result['silently_wrong'] = sum(faults.numbers['wrong'].values())
    result['damaged'] = faults.numbers | {'worst_ms': round(faults.worst_ms, 3)}
    return result


def _times(recording: TrialRecording) -> NDArray[np.int64]:
    return np.linspace(recording.events.t_us[0], recording.events.t_us[-1], POINTS).astype(np.int64)
