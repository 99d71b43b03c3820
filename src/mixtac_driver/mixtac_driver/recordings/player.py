# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Plays an open recording: batches when they are due, loops, jumps, stamps that never go back."""

from __future__ import annotations

import threading
from contextlib import closing
from typing import TYPE_CHECKING

from mixtac_driver.clock_map import ClockMap
from mixtac_driver.decoder import DecodedBatch
from mixtac_driver.errors import EndOfStream, RecordingError
from mixtac_driver.readings import NO_EDGES, NO_SAMPLES
from mixtac_driver.recordings.pieces import from_time
from mixtac_driver.recordings.timeline import GAP_US, Disorder, Timeline, whole_ms
from mixtac_driver.sequences import Origin
from mixtac_driver.stream import CameraBatch
from mixtac_events.arrays import Events

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterator

    from mixtac_driver.recordings.pieces import Recording
    from mixtac_driver.recordings.playback import PlaybackClock
    from mixtac_driver.recordings.playback_parameters import PlaybackParameters

STEP_US = 1000
"""Longest step in real time, so that packets of 1 ms leave on time."""
CLOSING_US = 100_000
"""Silence announced after the end: closes the longest packet that may be in the making."""


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
        loops: How often it began again.
        latest_us: Latest time handed on [us], or None.
        origin: What is added to recorded times to hand them on; None before the first batch.
        ended: True once everything was played.
        timeline: Where it is; a new one after every jump.
        disorder: What was found amiss with the order of recorded times.
        counts: What was handed on.
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
        self.counts = dict.fromkeys(('events', 'frames', 'imu', 'edges'), 0)
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
        """Yield what was recorded, each stretch when it is due, until stopped.

        Raises:
            EndOfStream: Everything was played, and it is not to loop.
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
                yield self._last()
                raise EndOfStream(f'{info.path} was played to its end')
            else:
                from_us, seeking = start_us, False
                self.loops += 1

    def seek(self, seconds: float) -> None:
        """Go on at another place.

        Args:
            seconds: Time after the first event [s]; beyond the end is the end.
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
        """Get ready to play from a time of the recording; False when stopped."""
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
        """Yield until interrupted or, which `ended` says, at the end; return whether any was."""
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
        """Move a time of the recording to after all that was handed on, or to now if wanted.

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
        self.latest_us = decoded.time_us + shift_us
        counts = self.counts
        counts['events'] += len(decoded.events)
        counts['frames'] += len(decoded.frames)
        counts['imu'] += len(decoded.imu.t)
        counts['edges'] += len(decoded.edges.t)
        return CameraBatch(decoded, self.origin, arrival_ns)

    def _last(self) -> CameraBatch:
        time_us = self.timeline.position_us - self.timeline.offset_us + CLOSING_US
        decoded = DecodedBatch(
            events=Events.empty(),
            frames=(),
            imu=NO_SAMPLES,
            edges=NO_EDGES,
            time_us=time_us,
            resets=self.disorder.resets,
        )
        return self._batch(decoded, self.timeline.offset_us)
