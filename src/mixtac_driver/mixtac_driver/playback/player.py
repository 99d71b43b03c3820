# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Plays an open recording in real time, faster or slower: batches when they are due, loops, seeks.

Published time never goes back: after a loop or a seek, stamps continue after the latest one.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import closing
from dataclasses import dataclass, replace

import numpy as np

from mixtac_driver.camera import CameraBatch
from mixtac_driver.clock import Origin
from mixtac_driver.errors import EndOfStream
from mixtac_driver.parameters import PlaybackParameters
from mixtac_events.arrays import Events
from mixtac_events.clock_map import ClockMap
from mixtac_events.readings import NO_EDGES, NO_SAMPLES, DecodedBatch
from mixtac_events.windows import RESTART_US
from mixtac_recordings.recording import Piece, Recording, RecordingError, from_time

GAP_US = 1000
"""Time from the end of one stretch to the start of the next, where recorded time goes back."""
MOST_AHEAD_US = 10_000_000
"""A frame or sample further ahead than this has a stamp of another clock: it does not wait."""
_NOTHING = Events.empty()


def whole_ms(t_us: int) -> int:
    """Round up to whole milliseconds: shifts by those keep packets on the grid they came on."""
    return -(-t_us // 1000) * 1000


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """A stretch of the recording that is published at once.

    Attributes:
        due_us: When it is due [us, recorded camera clock plus `offset_us`].
        offset_us: Add it to the times of `decoded` for times that never go back.
        decoded: The data, on the recorded camera clock.
    """

    due_us: int
    offset_us: int
    decoded: DecodedBatch


@dataclass(slots=True)
class Disorder:
    """Counts of recorded times out of order.

    Attributes:
        resets: Restarts of the recorded clock.
        late_events: Events dropped because playback had passed their time.
        unsorted_events: Events that were out of order within their packet; sorted.
    """

    resets: int = 0
    late_events: int = 0
    unsorted_events: int = 0

    @property
    def out_of_order(self) -> int:
        """Events dropped or sorted because of their time."""
        return self.late_events + self.unsorted_events


class Timeline:
    """Cuts pieces into steps.

    Args:
        start_us: Time to start at [us, recorded camera clock].
        step_us: Longest step; 0 for steps as long as the pieces are. May be changed.
        disorder: Where to count times out of order.

    Attributes:
        position_us: Time reached [us, recorded camera clock plus `offset_us`].
        disorder: As given.
        offset_us: Grows when the recorded clock was reset, so that time goes on.
    """

    def __init__(self, start_us: int, step_us: int, disorder: Disorder) -> None:
        self.step_us = step_us
        self.position_us = start_us
        self.offset_us = 0
        self.disorder = disorder
        self._pace_us = start_us

    def steps(self, piece: Piece) -> Iterator[Step]:
        """Yield the steps of a piece; take them all before the next piece."""
        if not piece.advances:
            yield self._aside(piece)
            return
        if piece.until_us + self.offset_us < self.position_us - RESTART_US:
            self.offset_us = whole_ms(self.position_us + GAP_US - piece.start_us)
            self.disorder.resets += 1
        events = self._in_time(piece.events)
        start_us, until_us = piece.start_us + self.offset_us, piece.until_us + self.offset_us
        if len(events):
            # In an unsorted packet, the last event is not the latest.
            until_us = max(until_us, int(events.t[-1]) + self.offset_us)
        while self.step_us and (end_us := self._next_us()) <= start_us:
            yield self._step(end_us, _NOTHING)
        taken = 0
        while self.step_us and (end_us := self._next_us()) < until_us:
            last = int(np.searchsorted(events.t, end_us - self.offset_us))
            yield self._step(end_us, events[taken:last])
            taken = last
        yield self._step(max(until_us, self.position_us), events[taken:], piece)

    def silence(self, length_us: int) -> DecodedBatch:
        """Return nothing until some time [us] after the end, on the recorded camera clock."""
        end_us = self.position_us - self.offset_us + length_us
        return replace(self._decoded(_NOTHING, None), time_us=end_us)

    def _next_us(self) -> int:
        return (self.position_us // self.step_us + 1) * self.step_us

    def _aside(self, piece: Piece) -> Step:
        # What was recorded behind later events is due with them.
        due_us = max(piece.start_us + self.offset_us, self.position_us)
        if due_us > self._pace_us + MOST_AHEAD_US:
            due_us = self._pace_us
        self._pace_us = max(self._pace_us, due_us)
        return Step(due_us, self.offset_us, self._decoded(_NOTHING, piece))

    def _step(self, time_us: int, events: Events, piece: Piece | None = None) -> Step:
        self.position_us = time_us
        self._pace_us = max(self._pace_us, time_us)
        return Step(time_us, self.offset_us, self._decoded(events, piece))

    def _decoded(self, events: Events, piece: Piece | None) -> DecodedBatch:
        return DecodedBatch(
            events=events,
            frames=piece.frames if piece else (),
            imu=piece.imu if piece else NO_SAMPLES,
            edges=piece.edges if piece else NO_EDGES,
            time_us=self.position_us - self.offset_us,
            resets=self.disorder.resets,
        )

    def _in_time(self, events: Events) -> Events:
        backwards = np.count_nonzero(events.t[1:] < events.t[:-1])
        if backwards:
            self.disorder.unsorted_events += int(backwards)
            events = events[np.argsort(events.t, kind='stable')]
        late = int(np.searchsorted(events.t, self.position_us - self.offset_us))
        self.disorder.late_events += late
        return events[late:]


def _latest_us(decoded: DecodedBatch) -> int:
    """Return the latest time of a batch [us]: frames and samples may outlast the events."""
    times = [frame.exposure_end_us for frame in decoded.frames]
    times += [int(each.t[-1]) for each in (decoded.imu, decoded.edges) if len(each.t)]
    return max(decoded.time_us, min(max(times, default=0), decoded.time_us + MOST_AHEAD_US))


LATE_S = 0.01
LONGEST_WAIT_S = 3600.0


@dataclass(slots=True)
class Lag:
    """Delay of playback; nothing is skipped and the clock is not slowed.

    Attributes:
        now_s: At the latest step [s].
        most_s: At the worst step [s].
        late_steps: Steps more than LATE_S behind.
    """

    now_s: float = 0.0
    most_s: float = 0.0
    late_steps: int = 0


class PlaybackClock:
    """Clock of playback: sleeps until recorded data are due.

    `wait_until` is for one thread, everything else for any.

    Args:
        rate: Recorded seconds per second; 0 never waits.
        now_s: Clock [s] that only goes forward.
        changed: Condition that is waited on.

    Attributes:
        lag: Delay of playback.
    """

    def __init__(
        self,
        rate: float = 1.0,
        *,
        now_s: Callable[[], float] = time.monotonic,
        changed: threading.Condition | None = None,
    ) -> None:
        self.lag = Lag()
        self._rate = rate
        self._now_s = now_s
        self._changed = changed or threading.Condition()
        self._anchor: tuple[float, float] | None = None
        self._paused_at_s: float | None = None
        self._interrupted = False
        self._reached_us: int | None = None

    @property
    def rate(self) -> float:
        """Recorded seconds per second; 0 never waits."""
        return self._rate

    @property
    def is_paused(self) -> bool:
        """True between `pause` and `resume`."""
        return self._paused_at_s is not None

    def restart(self) -> None:
        """Start again: the next wait is due at once, and waits are no longer interrupted."""
        with self._changed:
            self._anchor = None
            self._reached_us = None
            self._interrupted = False

    def set_rate(self, rate: float) -> None:
        """Continue at another rate from the current position."""
        with self._changed:
            if rate != self._rate:
                self._rate = rate
                self._anchor = None
                self._changed.notify_all()

    def pause(self) -> None:
        """Pause playback."""
        with self._changed:
            if self._paused_at_s is None:
                self._paused_at_s = self._now_s()
                self._changed.notify_all()

    def resume(self) -> None:
        """Continue after `pause`."""
        with self._changed:
            if self._paused_at_s is None:
                return
            if self._anchor is not None:
                at_s, at_us = self._anchor
                self._anchor = (at_s + self._now_s() - self._paused_at_s, at_us)
            self._paused_at_s = None
            self._changed.notify_all()

    def interrupt(self) -> None:
        """End the wait in progress and all later ones until `restart`."""
        with self._changed:
            self._interrupted = True
            self._changed.notify_all()

    def wait_until(self, due_us: int) -> bool:
        """Sleep until a recorded time is due.

        Args:
            due_us: The time [us], on a clock that only goes forward.

        Returns:
            False where the wait was interrupted.
        """
        with self._changed:
            while not self._interrupted:
                if self._paused_at_s is not None:
                    self._changed.wait()
                    continue
                remaining_s = self._remaining_s(due_us)
                if remaining_s <= 0:
                    self._reached(due_us, max(-remaining_s, 0.0))
                    return True
                self._changed.wait(min(remaining_s, LONGEST_WAIT_S))
            return False

    def _remaining_s(self, due_us: int) -> float:
        if self._rate == 0:
            return 0.0
        now_s = self._now_s()
        if self._anchor is None:
            # After a change of rate, the position is that of the data handed on last.
            from_us = due_us if self._reached_us is None else self._reached_us
            self._anchor = (now_s, from_us)
        at_s, at_us = self._anchor
        return at_s + (due_us - at_us) / 1e6 / self._rate - now_s

    def _reached(self, due_us: int, behind_s: float) -> None:
        self._reached_us = due_us
        self.lag.now_s = behind_s
        self.lag.most_s = max(self.lag.most_s, behind_s)
        self.lag.late_steps += behind_s > LATE_S


STEP_US = 1000
"""Longest step in real time, so that packets of 1 ms leave on time."""
CLOSING_US = 100_000
"""Silence announced after the end: closes the longest packet that may be pending."""


class Player:
    """Plays one open recording.

    `batches` is for one thread, everything else may be used from others.

    Args:
        recording: The recording.
        playback: How to play it; may be replaced.
        pace: The clock to play on.
        now_ns: Host clock [ns since the Unix epoch].
        after_us: Latest time that was handed on before [us], or None.

    Attributes:
        playback: How it is played.
        clock: Map from the recorded camera clock [us] to the host's; only fed in real time.
        loops: How often it started again from the beginning.
        latest_us: Latest time handed on [us], or None.
        origin: Added to recorded times for published ones; None before the first batch.
        ended: True once everything was played.
        timeline: Position; a new one after every jump.
        disorder: Counts of recorded times out of order.
    """

    def __init__(
        self,
        recording: Recording,
        playback: PlaybackParameters,
        pace: PlaybackClock,
        *,
        now_ns: Callable[[], int],
        after_us: int | None = None,
    ) -> None:
        self.playback = playback
        self.clock = ClockMap()
        self.loops = 0
        self.latest_us = after_us
        self.origin: Origin | None = None
        self.ended = False
        self.disorder = Disorder()
        self.timeline = Timeline(recording.info.start_us, 0, self.disorder)
        self._recording, self._pace, self._now_ns = recording, pace, now_ns
        self._lock = threading.Lock()
        self._stopping = False
        self._seek_us: int | None = None
        self._shift_us = 0

    @property
    def position_s(self) -> float:
        """Recorded time played, from the first event [s]."""
        start_us = self._recording.info.start_us
        return (self.timeline.position_us - self.timeline.offset_us - start_us) / 1e6

    def batches(self) -> Iterator[CameraBatch]:
        """Yield the recorded data, each stretch when it is due, until stopped.

        Raises:
            EndOfStream: Everything was played, and playback does not loop.
            RecordingError: The data are damaged, or the start offset lies beyond the end.
        """
        info = self._recording.info
        start_us = from_us = info.start_us + round(self.playback.playback_start * 1e6)
        seeking = False
        while self._begin(from_us):
            played = yield from self._play(from_us)
            wanted_us = self._take_seek()
            if wanted_us is not None:
                from_us, seeking = info.start_us + wanted_us, True
            elif not self.ended:
                return
            elif not played and not seeking:
                raise RecordingError(
                    f'playback_start = {self.playback.playback_start:g} s lies beyond the end of '
                    f'{info.path}, which is {info.length_us / 1e6:g} s long'
                )
            elif not self.playback.playback_loop:
                yield self._batch(self.timeline.silence(CLOSING_US), self.timeline.offset_us)
                raise EndOfStream(f'{info.path} was played to its end')
            else:
                from_us, seeking = start_us, False
                self.loops += 1

    def seek(self, seconds: float) -> None:
        """Continue at another position.

        Args:
            seconds: Time after the first event [s]; beyond the end stands for the end.
        """
        with self._lock:
            self._seek_us = max(round(seconds * 1e6), 0)
            self._pace.interrupt()

    def stop(self) -> None:
        """Make `batches` end soon; returns at once."""
        with self._lock:
            self._stopping = True
            self._pace.interrupt()

    def _take_seek(self) -> int | None:
        with self._lock:
            wanted_us, self._seek_us = self._seek_us, None
            return None if self._stopping else wanted_us

    def _begin(self, from_us: int) -> bool:
        """Prepare playback from a time of the recording; False when stopped."""
        with self._lock:
            if self._stopping:
                return False
            if self._seek_us is None:
                self._pace.restart()
        self.clock.restart()
        self.timeline = Timeline(from_us, self._step_us(), self.disorder)
        self.ended = False
        return True

    def _step_us(self) -> int:
        rate = self._pace.rate
        return whole_ms(max(STEP_US, round(STEP_US * rate))) if rate else 0

    def _play(self, from_us: int) -> Generator[CameraBatch, None, bool]:
        """Yield until interrupted or at the end (see `ended`); return whether any data came."""
        played, timeline = False, self.timeline
        with closing(self._recording.pieces(from_us)) as pieces:
            for piece in from_time(pieces, from_us):
                for step in timeline.steps(piece):
                    if not played:
                        self._place(from_us, step.due_us)
                    if not self._pace.wait_until(step.due_us):
                        return played
                    timeline.step_us = self._step_us()
                    played = True
                    yield self._batch(step.decoded, step.offset_us)
        self.ended = True
        return played

    def _place(self, from_us: int, now_due_us: int) -> None:
        """Shift a time of the recording to after all published data, or to now if requested.

        Args:
            from_us: Earliest time that will be handed on [us, recorded camera clock].
            now_due_us: What is due now [us, recorded camera clock].
        """
        if self.playback.playback_restamp:
            self._shift_us = (self._now_ns() // 1000 - now_due_us) // 1000 * 1000
        if self.latest_us is not None and from_us + self._shift_us < self.latest_us + GAP_US:
            self._shift_us = whole_ms(self.latest_us + GAP_US - from_us)

    def _batch(self, decoded: DecodedBatch, offset_us: int) -> CameraBatch:
        shift_us = self._shift_us + offset_us
        if self.origin is None or self.origin.us != shift_us:
            self.origin = Origin(shift_us * 1000, 0)
            self.clock.restart()
        arrival_ns = self._now_ns()
        if self._pace.rate == 1:
            self.clock.add(decoded.time_us, arrival_ns)
        elif self.clock.ready:
            # At another rate the clocks have no map.
            self.clock.restart()
        latest_us = _latest_us(decoded) + shift_us
        self.latest_us = latest_us if self.latest_us is None else max(self.latest_us, latest_us)
        return CameraBatch(decoded, self.origin, arrival_ns)
