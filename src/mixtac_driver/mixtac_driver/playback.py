# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A recording as a source of the driver, in place of a camera.

Published time never goes back: after a loop or a reset of the recorded clock, stamps continue after
the latest one.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from itertools import takewhile
from pathlib import Path

import numpy as np

from mixtac_core.events.arrays import Events
from mixtac_core.events.clock_map import ClockMap
from mixtac_core.events.readings import NO_EDGES, NO_SAMPLES, DecodedBatch
from mixtac_core.events.windows import RESTART_US
from mixtac_core.recordings.camera_stream import Recording, open_recording
from mixtac_core.recordings.recording import (
    Piece,
    ReadCounters,
    RecordingError,
    RecordingInfo,
    Selection,
)
from mixtac_driver.camera import CameraBatch, SourceStatus
from mixtac_driver.clock import Origin
from mixtac_driver.davis346.control import PixelFilter
from mixtac_driver.davis346.model import DAVIS346, Clocks, Geometry, Identity
from mixtac_driver.errors import EndOfStream
from mixtac_driver.parameters import DriverParameters

GAP_US = 1000
"""Time from the end of one stretch to the start of the next, where recorded time goes back [us]."""
MOST_AHEAD_US = 10_000_000
"""A frame or sample further ahead than this has a stamp of another clock and does not wait [us]."""
STEP_US = 1000
"""Longest step in real time [us], so that packets of 1 ms leave on time."""
CLOSING_US = 100_000
"""Silence reported after the end [us]: it closes the longest packet that may be pending."""
BEHIND_S = 0.1
"""Delay of playback from which on it is reported [s]."""
_NOTHING = Events.empty()


def whole_ms(t_us: int) -> int:
    """Round up to whole milliseconds [us]: such shifts keep packets on their grid."""
    return -(-t_us // 1000) * 1000


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """A stretch of the recording that is published at once.

    Attributes:
        due_us: When it is due [us, recorded camera clock plus `offset_us`].
        offset_us: Shift of the times of `decoded` that keeps them from going back [us].
        decoded: The data, on the recorded camera clock.
    """

    due_us: int
    offset_us: int
    decoded: DecodedBatch

    @property
    def latest_us(self) -> int:
        """Latest time in it [us]: frames and samples may outlast the events."""
        d = self.decoded
        times = [frame.exposure_end_us for frame in d.frames]
        times += [int(each.t[-1]) for each in (d.imu, d.edges) if len(each.t)]
        latest_us = min(max(times, default=0), d.time_us + MOST_AHEAD_US)
        return self.offset_us + max(d.time_us, latest_us)


class Timeline:
    """Cuts pieces into steps, and counts recorded times that are out of order.

    Args:
        start_us: Time to start at [us, recorded camera clock].

    Attributes:
        position_us: Time that playback has reached [us, recorded camera clock plus `offset_us`].
        offset_us: Grows when the recorded clock was reset, so that time continues [us].
        resets: Resets of the recorded clock.
        out_of_order: Events that were sorted within their packet, or discarded as too late.
    """

    def __init__(self, start_us: int) -> None:
        self.resets = self.out_of_order = 0
        self.restart(start_us)

    def restart(self, start_us: int) -> None:
        """Start at a time [us, recorded camera clock]; the counts continue."""
        self.position_us = self._due_us = start_us
        self.offset_us = 0

    def steps(self, pieces: Iterable[Piece], length_us: Callable[[], int]) -> Iterator[Step]:
        """Yield the steps of a recording in order.

        Args:
            pieces: Pieces in recorded order.
            length_us: Returns the longest step [us]; 0 for steps as long as the pieces.
        """
        for piece in pieces:
            if piece.advances:
                yield from self._advance(piece, length_us)
            else:
                yield self._aside(piece)

    def silence(self, length_us: int) -> Step:
        """Return a step without data that reaches some time [us] beyond the position."""
        end_us = self.position_us + length_us
        nothing = replace(self._decoded(_NOTHING, None), time_us=end_us - self.offset_us)
        return Step(end_us, self.offset_us, nothing)

    def _advance(self, piece: Piece, length_us: Callable[[], int]) -> Iterator[Step]:
        if piece.until_us + self.offset_us < self.position_us - RESTART_US:
            self.offset_us = whole_ms(self.position_us + GAP_US - piece.start_us)
            self.resets += 1
        events = self._in_time(piece.events)
        until_us = piece.until_us + self.offset_us
        if len(events):
            # In an unsorted packet, the last event is not the latest.
            until_us = max(until_us, int(events.t[-1]) + self.offset_us)
        while step_us := length_us():
            end_us = (self.position_us // step_us + 1) * step_us
            if end_us >= until_us:
                break
            count = int(np.searchsorted(events.t, end_us - self.offset_us))
            yield self._step(end_us, events[:count])
            events = events[count:]
        yield self._step(max(until_us, self.position_us), events, piece)

    def _aside(self, piece: Piece) -> Step:
        # What was recorded behind later events is due with them.
        due_us = max(piece.start_us + self.offset_us, self.position_us)
        if due_us > self._due_us + MOST_AHEAD_US:
            due_us = self._due_us
        self._due_us = max(self._due_us, due_us)
        return Step(due_us, self.offset_us, self._decoded(_NOTHING, piece))

    def _step(self, time_us: int, events: Events, piece: Piece | None = None) -> Step:
        self.position_us = time_us
        self._due_us = max(self._due_us, time_us)
        return Step(time_us, self.offset_us, self._decoded(events, piece))

    def _decoded(self, events: Events, piece: Piece | None) -> DecodedBatch:
        return DecodedBatch(
            events=events,
            frames=piece.frames if piece else (),
            imu=piece.imu if piece else NO_SAMPLES,
            edges=piece.edges if piece else NO_EDGES,
            time_us=self.position_us - self.offset_us,
            resets=self.resets,
        )

    def _in_time(self, events: Events) -> Events:
        backwards = int(np.count_nonzero(events.t[1:] < events.t[:-1]))
        if backwards:
            events = events[np.argsort(events.t, kind='stable')]
        late = int(np.searchsorted(events.t, self.position_us - self.offset_us))
        self.out_of_order += backwards + late
        return events[late:]


def replayed_identity(info: RecordingInfo) -> Identity:
    """Return an identity with the size and colours of the recorded camera; versions are zero.

    Args:
        info: The recording. Its format stands for the chip, which is not recorded.
    """
    width, height = info.width, info.height
    return Identity(
        model=replace(DAVIS346, name=info.kind, chips=(), width=width, height=height),
        serial=info.camera.rpartition('_')[2],
        chip=info.kind,
        geometry=Geometry(width, height, False, width, height, False),
        # Recorded exposures are in microseconds already.
        clocks=Clocks(logic=1.0, adc=1.0, usb=1.0),
        color_filter=info.color_filter,
    )


def from_time(pieces: Iterable[Piece], from_us: int) -> Iterator[Piece]:
    """Yield pieces without the data before a time.

    Once a recorded clock was reset, everything counts as later. What was recorded between the reset
    and the first packet of the new clock is left out.

    Args:
        pieces: Pieces in recorded order.
        from_us: The time [us, recorded camera clock].
    """
    latest_us, reset = 0, False
    for piece in pieces:
        behind = piece.until_us < latest_us - RESTART_US
        if piece.advances:
            reset |= behind
            latest_us = piece.until_us if behind else max(latest_us, piece.until_us)
        elif behind:
            continue
        if reset or piece.start_us >= from_us:
            yield piece
        elif piece.until_us >= from_us:
            yield replace(
                piece,
                start_us=from_us,
                events=piece.events[piece.events.t >= from_us],
                frames=tuple(frame for frame in piece.frames if frame.middle_us >= from_us),
                imu=piece.imu[piece.imu.t >= from_us],
                edges=piece.edges[piece.edges.t >= from_us],
            )


class RecordedSource:
    """Plays a recording (see `mixtac_driver.supervisor.Source`).

    `batches` is for one thread, everything else may be used from others.

    Args:
        parameters: Path of the recording (`device`) and how to play it (`playback_*`).
        now_ns: Host clock [ns since the Unix epoch].

    Attributes:
        control: None: a recording accepts no requests.
    """

    def __init__(
        self, parameters: DriverParameters, now_ns: Callable[[], int] = time.time_ns
    ) -> None:
        self.control = None
        self._p, self._now_ns = parameters, now_ns
        self._changed = threading.Condition()
        self._recording: Recording | None = None
        self._info: RecordingInfo | None = None
        self._counters = ReadCounters()
        self._timeline = Timeline(0)
        self._clock = ClockMap()
        self._origin: Origin | None = None
        self._latest_us: int | None = None
        self._loops = 0
        self._lag_s = 0.0
        self._stopping = self._ended = False
        self._reached_us: int | None = None
        # Host time [s], recorded time [us] and rate from which the due time is counted.
        self._anchor: tuple[float, int, float] | None = None

    def status(self) -> SourceStatus:
        """Return the state of playback."""
        info, line = self._info, self._timeline
        if info is None:
            return SourceStatus(is_open=False, identity=None, clock=self._clock, origin=None)
        playing = 'paused' if self._p.playback_paused else 'playing'
        late = f'playback is {self._lag_s:.1f} s behind' if self._lag_s > BEHIND_S else ''
        return SourceStatus(
            is_open=self._recording is not None,
            identity=replayed_identity(info),
            clock=self._clock,
            origin=self._origin,
            losses={
                'events outside': self._counters.events_outside,
                'timestamps backwards': self._timeline.out_of_order,
            },
            figures={
                'recording': info.kind,
                **{f'recorded {kind}': name for kind, name in info.contents},
                'playback': 'ended' if self._ended else playing,
                'playback rate': self._p.playback_rate,
                'playback position [s]': (line.position_us - line.offset_us - info.start_us) / 1e6,
                'playback length [s]': info.length_us / 1e6,
                'playback loops': self._loops,
                'playback lag [s]': self._lag_s,
                'packets missing in the recording': self._counters.packets_missing,
                'clock resets': line.resets,
            },
            paused=self._p.playback_paused and not self._ended,
            trouble=late or info.damage,
        )

    def open(self) -> None:
        """Open the recording.

        Raises:
            RecordingError: It cannot be played.
        """
        p = self._p
        wanted = Selection(p.playback_events_topic, p.playback_image_topic, p.playback_imu_topic)
        self._recording = open_recording(Path(p.device), wanted)
        self._info, self._counters = self._recording.info, self._recording.counters
        self._timeline.restart(self._info.start_us)

    def start(self) -> None:
        """Prepare playback from `playback_start`; times continue after an earlier stream."""
        self._stopping = self._ended = False

    def batches(self) -> Iterator[CameraBatch]:
        """Yield the recorded data, each stretch when it is due, until stopped.

        Raises:
            EndOfStream: Everything was played, and playback does not loop.
            RecordingError: It is not open, its data are damaged, or the start offset lies beyond
                its end.
        """
        recording = self._recording
        if recording is None:
            raise RecordingError(f'{self._p.device} is not open', remedy='call open() first')
        info, start_s = recording.info, self._p.playback_start
        start_us = info.start_us + round(start_s * 1e6)
        while True:
            self._timeline.restart(start_us)
            self._anchor = self._reached_us = shift_us = None
            with closing(recording.pieces()) as pieces:
                wanted = takewhile(lambda _: not self._stopping, pieces)
                steps = self._timeline.steps(from_time(wanted, start_us), self._step_us)
                for step in steps:
                    if shift_us is None:
                        shift_us = self._shift_us(start_us, step.due_us)
                    if not self._wait(step.due_us):
                        return
                    yield self._batch(step, shift_us)
            if self._stopping:
                return
            if shift_us is None:
                raise RecordingError(
                    f'playback_start = {start_s:g} s lies beyond the end of '
                    f'{info.path}, which is {info.length_us / 1e6:g} s long'
                )
            if not self._p.playback_loop:
                self._ended = True
                yield self._batch(self._timeline.silence(CLOSING_US), shift_us)
                raise EndOfStream(f'{info.path} was played to its end')
            self._loops += 1

    def apply(self, parameters: DriverParameters, pixel_filter: PixelFilter = ()) -> None:
        """Change how the recording is played: rate, loop and pause, at once.

        Args:
            parameters: All of them; settings of a camera have no effect.
            pixel_filter: Has no effect.
        """
        del pixel_filter
        with self._changed:
            self._p = replace(parameters, device=self._p.device)
            self._changed.notify_all()

    def request_stop(self) -> None:
        """Make `batches` end soon; returns at once."""
        with self._changed:
            self._stopping = True
            self._changed.notify_all()

    def close(self) -> None:
        """Stop playback and close the file."""
        self.request_stop()
        recording, self._recording = self._recording, None
        if recording is not None:
            recording.close()

    def _step_us(self) -> int:
        rate = self._p.playback_rate
        return whole_ms(max(STEP_US, round(STEP_US * rate))) if rate else 0

    def _wait(self, due_us: int) -> bool:
        """Sleep until a recorded time [us] is due; return False if playback is stopped."""
        with self._changed:
            while not self._stopping:
                if self._p.playback_paused:
                    self._anchor = None
                    self._changed.wait()
                    continue
                left_s = self._left_s(due_us)
                if left_s <= 0:
                    self._reached_us = due_us
                    self._lag_s = -left_s
                    return True
                self._changed.wait(min(left_s, threading.TIMEOUT_MAX))
            return False

    def _left_s(self, due_us: int) -> float:
        """Return the time until a recorded time [us] is due [s]; negative if it is late."""
        now_s, rate = time.monotonic(), self._p.playback_rate
        if self._anchor is None or self._anchor[2] != rate:
            # After a pause or a change of rate, the position is that of the latest step.
            from_us = due_us if self._reached_us is None else self._reached_us
            self._anchor = now_s, from_us, rate
            self._clock.restart()
        at_s, at_us, _ = self._anchor
        return at_s + (due_us - at_us) / 1e6 / rate - now_s if rate else 0.0

    def _shift_us(self, from_us: int, due_us: int) -> int:
        """Return the shift to published time [us]: to now if wanted, after all published data.

        Args:
            from_us: Earliest time that is played [us, recorded camera clock].
            due_us: What is due now [us, recorded camera clock].
        """
        shift_us = 0
        if self._p.playback_restamp:
            shift_us = (self._now_ns() // 1000 - due_us) // 1000 * 1000
        if self._latest_us is not None and from_us + shift_us < self._latest_us + GAP_US:
            shift_us = whole_ms(self._latest_us + GAP_US - from_us)
        return shift_us

    def _batch(self, step: Step, shift_us: int) -> CameraBatch:
        origin_us = shift_us + step.offset_us
        if self._origin is None or self._origin.us != origin_us:
            self._origin = Origin(origin_us * 1000, 0)
            self._clock.restart()
        arrival_ns = self._now_ns()
        if self._p.playback_rate == 1:
            # At another rate the clocks have no map.
            self._clock.add(step.decoded.time_us, arrival_ns)
        latest_us = step.latest_us + shift_us
        self._latest_us = max(self._latest_us or latest_us, latest_us)
        return CameraBatch(step.decoded, self._origin, arrival_ns)
