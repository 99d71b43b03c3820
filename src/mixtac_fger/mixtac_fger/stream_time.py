# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the times of arriving packets say: the stream goes on, has a hole, or begins anew."""

from __future__ import annotations

from enum import Enum
from typing import Final

BACKWARD_US: Final = 20_000
"""A step back beyond this is a restarted clock: packets of one camera come in order."""
LONG_HOLE_US: Final = 100_000
"""A hole beyond this makes the estimate start from the next frame; shorter ones it gets over."""
JUMP_US: Final = 1_000_000
"""A step forward beyond this is a hole also without lost packets: no camera is silent so long."""


class Arrival(Enum):
    """How a packet follows the one before."""

    GOES_ON = 'goes on'
    AFTER_HOLE = 'after a hole'
    STARTS = 'starts a stream, or follows a long hole or a restart of the clock'


class StreamTime:
    """Follows the time of a stream and remembers the stretch that no packet told of.

    Attributes:
        newest_us: Time up to which the stream is known, camera clock [us]; None before the first.
        gaps: Holes, the long ones included.
        restarts: Times the clock went back.
        skipped_us: Camera time in holes that began the estimate anew [us].
    """

    def __init__(self) -> None:
        self.newest_us: int | None = None
        self.gaps = 0
        self.restarts = 0
        self.skipped_us = 0
        self._hole_us = (0, 0)

    def push(self, first_us: int, complete_until_us: int, *, lost_before: bool) -> Arrival:
        """Take the times of a packet and say how it follows.

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
            return Arrival.GOES_ON
        self.gaps += 1
        if step > LONG_HOLE_US:
            self.skipped_us += step
            return self._start(first_us, complete_until_us)
        self._hole_us = newest, first_us
        return Arrival.AFTER_HOLE

    def covered(self, end_us: int, width_us: int) -> tuple[bool, bool]:
        """Return whether packets told of anything, and of everything, in a window.

        Args:
            end_us: End of the window.
            width_us: Width of it.
        """
        begin, end = self._hole_us
        missing = min(end_us, end) - max(end_us - width_us, begin)
        return missing < width_us, missing <= 0

    def forget(self) -> None:
        """Have the next packet start a stream."""
        self.newest_us = None

    def _start(self, first_us: int, complete_until_us: int) -> Arrival:
        self.newest_us = complete_until_us
        # Of what was before the first event nothing is known.
        self._hole_us = (first_us - JUMP_US, first_us)
        return Arrival.STARTS
