# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Which host time the camera's clock started from, followed over resets of that clock."""

from __future__ import annotations

from mixtac_driver.sequences import Origin


class ClockEpochs:
    """Follows the resets of a camera's clock and keeps published time from going back.

    The first reset that arrives after it was asked for is the one whose host time was measured.
    Later ones come from the synchronisation cable or from the camera itself: the host time of
    those is estimated from their arrival.

    Args:
        asked: Host time of the reset that was asked for.
        delay_us: Time that data may wait in the camera [us]: the error of an estimated origin.
        latest_us: Time published before, by an earlier stream [us, epoch-based camera clock].

    Attributes:
        unasked: Resets that came without being asked for.
        latest_us: Latest time handed out [us, epoch-based camera clock].
    """

    def __init__(self, asked: Origin, delay_us: int, latest_us: int = 0) -> None:
        self.unasked = 0
        self.latest_us = latest_us
        self._origin = asked
        self._delay_us = delay_us
        self._confirmed = False
        self._resets = 0

    @property
    def origin(self) -> Origin | None:
        """Host time at which the camera's clock read zero; None before a reset was seen."""
        return self._origin if self._confirmed else None

    def follow(self, resets: int, time_us: int, arrival_ns: int) -> Origin | None:
        """Return the origin for a stretch of the stream, or None while it has none.

        Args:
            resets: Resets seen in the stream before the stretch.
            time_us: Time the stretch reached [us on the camera clock since its reset].
            arrival_ns: Host time of arrival [ns since the Unix epoch].
        """
        if resets != self._resets:
            self._resets = resets
            self._reset(time_us, arrival_ns)
        if not self._confirmed:
            return None
        self.latest_us = max(self.latest_us, time_us + self._origin.us)
        return self._origin

    def _reset(self, time_us: int, arrival_ns: int) -> None:
        if not self._confirmed:
            earliest_ns = self._origin.host_ns - self._origin.uncertainty_ns
            self._confirmed = arrival_ns >= earliest_ns
            uncertainty_us = self._origin.uncertainty_ns / 1000
            self._set(self._origin.us, uncertainty_us)
        else:
            self.unasked += 1
            self._set(arrival_ns // 1000 - time_us, self._delay_us)

    def _set(self, wanted_us: int, uncertainty_us: float) -> None:
        # A camera whose clock is fast has published times that the host has yet to reach.
        late_us = max(self.latest_us + 1 - wanted_us, 0)
        uncertainty_ns = round((uncertainty_us + late_us) * 1000)
        self._origin = Origin((wanted_us + late_us) * 1000, uncertainty_ns)
