# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Simulated recordings with known clocks, whole and damaged, for the benchmark of the alignment."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from mixtac_alignment.event_history import CellEvents, by_cell
from mixtac_alignment.frame_features import FrameFeatures, reduce_frame
from mixtac_alignment.rate_history import EventCounts
from mixtac_events.codec import DAVIS346_HEIGHT, DAVIS346_WIDTH
from mixtac_sim.presets import PRESETS, preset
from mixtac_sim.trial import simulate_trial

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

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
    events = by_cell(trial.events, DAVIS346_WIDTH, DAVIS346_HEIGHT)
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
