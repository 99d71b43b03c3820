# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Gaps in a stream: missing message numbers, and intervals that no packet covers.

All receivers of event packets count their losses with this module.
"""

from __future__ import annotations

from enum import Enum
from typing import Final

RESTART_STEP = 1_000_000
"""A larger step forward is a restart of the sender: 1000 s without packets at 1 kHz."""


class SequenceCounter:
    """Counts received, lost and repeated messages by their numbers, and restarts of the sender.

    Attributes:
        received: Messages seen, without repetitions.
        lost: Messages missing between them. Messages missing around a restart are not counted,
            because their number is unknown.
        repeated: Messages with the number of the one before.
        restarts: Times that the numbers went back, or forward by more than RESTART_STEP.
        continuous: False if something is missing directly before the latest message: a loss or
            a restart. True after the first message.
        last: Number of the latest message, None before the first.
    """

    def __init__(self) -> None:
        self.received = self.lost = self.repeated = self.restarts = 0
        self.continuous = True
        self.last: int | None = None

    def update(self, seq: int) -> int:
        """Count a message.

        Args:
            seq: Its number; the sender counts up by one.

        Returns:
            The number of messages missing before it: 0 for the first, after a restart and for a
            repetition, never negative.
        """
        seq = int(seq)
        step = 1 if self.last is None else seq - self.last
        self.last = seq
        self.continuous = step in {0, 1}
        if step == 0:
            self.repeated += 1
            return 0
        self.received += 1
        if not 0 < step <= RESTART_STEP:
            self.restarts += 1
            return 0
        self.lost += step - 1
        return step - 1


BACKWARD_US: Final = 20_000
"""A larger step back is a restarted clock, because packets of one camera come in order [us]."""
LONG_HOLE_US: Final = 100_000
"""After a longer hole the estimate starts from the next frame [us]."""
JUMP_US: Final = 1_000_000
"""A larger step forward is a hole even if no packet was lost: no camera is silent so long [us]."""


class Arrival(Enum):
    """How a packet relates to the one before."""

    CONTINUES = 'continues'
    AFTER_HOLE = 'after a hole'
    STARTS = 'starts a stream, or follows a long hole or a restart of the clock'


class StreamTime:
    """Follows the time of a stream and remembers the latest stretch that no packet covered.

    Attributes:
        newest_us: Time up to which the stream is known, camera clock [us]; None before the first.
        gaps: Holes of any length.
        restarts: Times the clock went back.
        skipped_us: Camera time in holes after which the estimate started over [us].
    """

    def __init__(self) -> None:
        self.newest_us: int | None = None
        self.gaps = 0
        self.restarts = 0
        self.skipped_us = 0
        self._hole_us = (0, 0)

    def push(self, first_us: int, complete_until_us: int, *, lost_before: bool) -> Arrival:
        """Add the times of a packet and return how it relates to the one before.

        Args:
            first_us: Its first event, or `complete_until_us` without one.
            complete_until_us: No event before this time will follow.
            lost_before: Packets directly before it are missing.
        """
        newest = self.newest_us
        if newest is None:
            return self._start(first_us, complete_until_us)
        if complete_until_us < newest - BACKWARD_US:
            self.restarts += 1
            return self._start(first_us, complete_until_us)
        self.newest_us = max(newest, complete_until_us)
        step = first_us - newest
        if step <= 0 or not (lost_before or step > JUMP_US):
            return Arrival.CONTINUES
        self.gaps += 1
        if step > LONG_HOLE_US:
            self.skipped_us += step
            return self._start(first_us, complete_until_us)
        self._hole_us = newest, first_us
        return Arrival.AFTER_HOLE

    def covered(self, end_us: int, width_us: int) -> tuple[bool, bool]:
        """Return whether packets covered any part of a window, and whether they covered all of it.

        Args:
            end_us: End of the window.
            width_us: Its length.
        """
        begin, end = self._hole_us
        missing = min(end_us, end) - max(end_us - width_us, begin)
        return missing < width_us, missing <= 0

    def _start(self, first_us: int, complete_until_us: int) -> Arrival:
        self.newest_us = complete_until_us
        # Nothing is known about the time before the first event.
        self._hole_us = (first_us - JUMP_US, first_us)
        return Arrival.STARTS
