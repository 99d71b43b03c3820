# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Origin of the camera clock in host time, followed over clock resets; check for time jumps."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from mixtac_driver.errors import StreamError


@dataclass(frozen=True, slots=True)
class Origin:
    """Host time at which the camera's clock read zero.

    Attributes:
        host_ns: Host time [ns since the Unix epoch], a multiple of 1000.
        uncertainty_ns: Greatest error of it [ns].
    """

    host_ns: int
    uncertainty_ns: int

    @property
    def us(self) -> int:
        """Host time [us since the Unix epoch]; add it to camera times to publish them."""
        return self.host_ns // 1000


JUMP_US = 1_000_000
"""Largest plausible lead [us]; real cameras were measured to gain at most 100 us per second."""
CONFIRMATION_NS = 1_000_000_000
"""A requested reset appears in the stream within this time."""


class ClockEpochs:
    """Follows the resets of a camera's clock and keeps published time from going back.

    The first reset that arrives after a request is the one whose host time was measured, the next
    one that of the next request. Others come from the synchronisation cable or from the camera
    itself; their host time is estimated from their arrival.

    Data can arrive late, but never early. The smallest delay is therefore a floor that only moves
    slowly, with the difference in rate of the two clocks; data below it carry a damaged time, as
    after one wrong time wrap.

    Args:
        asked: Host time of the requested reset.
        delay_us: Time that data may wait in the camera [us]: the error of an estimated origin.
        latest_us: Time published before, by an earlier stream [us, epoch-based camera clock].

    Attributes:
        unasked: Resets without a request.
        latest_us: Latest time returned [us, epoch-based camera clock].
    """

    def __init__(self, asked: Origin, delay_us: int, latest_us: int = 0) -> None:
        self.unasked = 0
        self.latest_us = latest_us
        self._origin = asked
        self._delay_us = delay_us
        self._confirmed = False
        self._floor_us = 0.0
        self._resets = 0
        self._pending: deque[Origin] = deque()
        self._asking = threading.Lock()

    @property
    def origin(self) -> Origin | None:
        """Host time at which the camera's clock read zero; None before a reset was seen."""
        return self._origin if self._confirmed else None

    def ask(self, reset: Callable[[], Origin]) -> None:
        """Reset the clock once more, from any thread.

        The thread that follows the stream waits where it sees a reset before its host time is
        known.

        Args:
            reset: Resets the clock and returns when that was.

        Raises:
            UsbError: As `reset` raises it.
        """
        with self._asking:
            self._pending.append(reset())

    def follow(self, resets: int, time_us: int, arrival_ns: int) -> Origin | None:
        """Return the origin for a stretch of the stream, or None while it has none.

        Args:
            resets: Resets seen in the stream before the stretch.
            time_us: Time the stretch reached [us on the camera clock since its reset].
            arrival_ns: Host time of arrival [ns since the Unix epoch].

        Raises:
            StreamError: The time is ahead of its arrival: the data were damaged.
        """
        for _ in range(resets - self._resets):
            self._reset(time_us, arrival_ns)
        self._resets = resets
        if not self._confirmed:
            return None
        reached_us = time_us + self._origin.us
        late_us = arrival_ns // 1000 - reached_us
        if late_us < self._floor_us - JUMP_US:
            ahead_s = (self._floor_us - late_us) / 1e6
            raise StreamError(
                f'the camera clock jumped {ahead_s:.1f} s ahead: damaged data, or the host clock '
                'was set back',
                remedy='none needed: the camera is restarted',
            )
        self._floor_us = min(self._floor_us, late_us)
        self.latest_us = max(self.latest_us, reached_us)
        return self._origin

    def _reset(self, time_us: int, arrival_ns: int) -> None:
        if not self._confirmed:
            earliest_ns = self._origin.host_ns - self._origin.uncertainty_ns
            self._confirmed = arrival_ns >= earliest_ns
            self._measured(self._origin, time_us, arrival_ns)
            return
        asked = self._asked_before(arrival_ns)
        if asked is not None:
            self._measured(asked, time_us, arrival_ns)
            return
        self.unasked += 1
        self._set(arrival_ns // 1000 - time_us, self._delay_us)

    def _asked_before(self, arrival_ns: int) -> Origin | None:
        with self._asking:
            while self._pending:
                asked = self._pending[0]
                late_ns = arrival_ns - (asked.host_ns - asked.uncertainty_ns)
                if late_ns < 0:
                    # This reset was on its way already; the requested one is still to come.
                    break
                self._pending.popleft()
                if late_ns <= CONFIRMATION_NS:
                    return asked
        return None

    def _measured(self, asked: Origin, time_us: int, arrival_ns: int) -> None:
        # Data after the reset arrive after it: their arrival bounds the reset.
        first_ns = asked.host_ns - asked.uncertainty_ns
        last_ns = min(asked.host_ns + asked.uncertainty_ns, arrival_ns - 1000 * time_us)
        if last_ns < first_ns:
            self._set(asked.us, asked.uncertainty_ns / 1000)
            return
        middle_us = (first_ns + last_ns + 1000) // 2000
        self._set(middle_us, (last_ns - first_ns) / 2000)

    def _set(self, wanted_us: int, uncertainty_us: float) -> None:
        # A fast camera clock has published times that lie ahead of the host.
        late_us = max(self.latest_us + 1 - wanted_us, 0)
        uncertainty_ns = round((uncertainty_us + late_us) * 1000)
        self._origin = Origin((wanted_us + late_us) * 1000, uncertainty_ns)
        self._floor_us = -(uncertainty_us + late_us)
