# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""How far a simulation may run ahead of whoever answers what its camera saw."""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

RESTART_US = 500_000
"""A step of the camera's clock against simulated time that means a new origin [us]."""


class AnswerPace:
    """Limits simulated time by answers that are stamped on the camera clock.

    The camera clock counts simulated time from an origin that is not known here. No answer comes
    before what it answers, so the largest difference of stamp and simulated time seen so far is
    nearest to that origin; it is too small by the smallest delay of an answer.

    Args:
        ahead_us: How far simulated time may be beyond the last answer [us].
        patience_s: Without an answer for so long (host time), none is waited for [s]: more than a
            busy host lets a process wait for its turn, or than slip control needs to be enabled.
        monotonic: The host's monotonic clock [s].

    Attributes:
        lag_us: Simulated time by which the last answer was late [us].
    """

    def __init__(
        self,
        ahead_us: int,
        patience_s: float = 3.0,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self._ahead_us = ahead_us
        self._patience_s = patience_s
        self._monotonic = monotonic
        self._origin_us: int | None = None
        self._answered_us = 0
        self._heard_s = -math.inf
        self.lag_us = 0

    def answer(self, stamp_us: int, now_us: int) -> None:
        """Take an answer.

        Args:
            stamp_us: End of the answered window, camera clock [us].
            now_us: Simulated time [us].
        """
        origin_us = stamp_us - now_us
        if self._origin_us is None or abs(origin_us - self._origin_us) > RESTART_US:
            self._origin_us = origin_us
        self._origin_us = max(self._origin_us, origin_us)
        self._answered_us = stamp_us - self._origin_us
        self.lag_us = now_us - self._answered_us
        self._heard_s = self._monotonic()

    def limit_us(self) -> int | None:
        """Return how far simulated time may go [us], None where nobody answers."""
        if self._monotonic() - self._heard_s > self._patience_s:
            return None
        return self._answered_us + self._ahead_us
