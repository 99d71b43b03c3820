# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Notices a camera clock that runs ahead of the host, as damaged data make it do."""

from __future__ import annotations

from mixtac_driver.errors import StreamError

JUMP_US = 1_000_000
"""How far ahead [us] is too far; what was measured of real cameras is 100 us per second at most."""


class JumpGuard:
    """Compares time in the stream with the time of its arrival.

    Data can arrive late, but never before they happened. The least lateness is therefore a floor
    which only the difference in rate of the two clocks moves, slowly; data below it carry a time
    that was damaged, as one wrong time wrap does for all that follows.
    """

    def __init__(self) -> None:
        self._floor_us = 0.0

    def restart(self, uncertainty_us: float) -> None:
        """Begin again after a reset of the camera's clock.

        Args:
            uncertainty_us: How far off [us] the host time of that reset may be.
        """
        self._floor_us = -uncertainty_us

    def check(self, time_us: int, arrival_us: int) -> None:
        """Look at a stretch of the stream.

        Args:
            time_us: Time it reached [us, epoch-based camera clock].
            arrival_us: Host time of its arrival [us since the Unix epoch].

        Raises:
            StreamError: The time is damaged.
        """
        late_us = arrival_us - time_us
        if late_us < self._floor_us - JUMP_US:
            ahead_s = (self._floor_us - late_us) / 1e6
            raise StreamError(
                f'the camera clock jumped {ahead_s:.1f} s ahead: damaged data, or the host clock '
                'was set back; starting the camera anew'
            )
        self._floor_us = min(self._floor_us, late_us)
