# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Simulated time that waits for the simulation, and for whoever answers it.

A loop that is closed through other processes must not act on old news: where the host is late, time
itself goes slower here, so that whoever takes it from `/clock` acts as soon after an event as on a
fast host.
"""

from __future__ import annotations

import time
from threading import Lock
from typing import TYPE_CHECKING

import numpy as np

from mixtac_sim.simulation_clock import SimulationClock

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from mixtac_sim.aps import ApsSettings
    from mixtac_sim.grasp.answer_pace import AnswerPace
    from mixtac_sim.pixels import PixelSettings
    from mixtac_sim.sensor import SensorOutput
    from mixtac_sim.virtual_sensor import Simulation


class PacedClock(SimulationClock):
    """Simulated time [us] that never passes what is simulated; safe to ask from any thread.

    Args:
        paces: Limit it further.
        monotonic_ns: The host's monotonic clock [ns].
        epoch_ns: The host's clock [ns since the Unix epoch].
    """

    def __init__(
        self,
        paces: Sequence[AnswerPace] = (),
        monotonic_ns: Callable[[], int] = time.monotonic_ns,
        epoch_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        super().__init__(monotonic_ns, epoch_ns)
        self._lock = Lock()
        self._paces = tuple(paces)
        self._reached_us = self._last_us = 0

    def reached(self, until_us: int) -> None:
        """Let time go on up to what is simulated now [us]."""
        with self._lock:
            self._reached_us = max(self._reached_us, until_us)

    def now_us(self) -> int:
        """Return simulated time now [us]; what the host was late is counted as lost."""
        with self._lock:
            now_us = super().now_us()
            late_us = now_us - self._limit_us()
            if late_us > 0:
                self.lost_us += late_us
                now_us -= late_us
            self._last_us = now_us
            return now_us

    def _limit_us(self) -> int:
        limits = [each.limit_us() for each in self._paces]
        limit_us = min([self._reached_us, *(each for each in limits if each is not None)])
        # Answers that come late hold time up; they do not turn it back.
        return max(limit_us, self._last_us)

    def lose(self, lost_us: int) -> None:
        """Let simulated time be ``lost_us`` [us] further behind the host."""
        with self._lock:
            super().lose(lost_us)

    def epoch_now_ns(self) -> int:
        """Return simulated time now [ns], counted from the host's time at the start."""
        return self.start_epoch_ns + 1000 * self.now_us()

    def to_epoch_ns(self, t_us: NDArray[np.int64]) -> NDArray[np.int64]:
        """Convert simulated times [us, int64] to the scale of ``epoch_now_ns`` [ns, int64]."""
        return np.asarray(self.start_epoch_ns + t_us * 1000, np.int64)


class PacedSimulation:
    """Tells the clock how far a simulation has come.

    Args:
        simulation: What is simulated.
        clock: The clock that waits for it.
    """

    def __init__(self, simulation: Simulation, clock: PacedClock) -> None:
        self._simulation = simulation
        self._clock = clock

    def advance(self, until_us: int) -> SensorOutput:
        """Simulate up to a time [us]."""
        output = self._simulation.advance(until_us)
        self._clock.reached(until_us)
        return output

    def configure_aps(self, settings: ApsSettings) -> None:
        """Change the frames to come."""
        self._simulation.configure_aps(settings)

    def configure_pixels(self, nominal: PixelSettings) -> None:
        """Change the event pixels, as new biases would."""
        self._simulation.configure_pixels(nominal)
