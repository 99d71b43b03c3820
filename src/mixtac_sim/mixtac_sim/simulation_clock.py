# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Simulated time in step with the host's clock."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray


class SimulationClock:
    """Simulated time [us] that runs with the host's monotonic clock once started.

    A host that cannot keep up makes simulated time stand still for a while; that loss is counted.

    Args:
        monotonic_ns: The host's monotonic clock [ns].
        epoch_ns: The host's clock [ns since the Unix epoch].
    """

    def __init__(
        self,
        monotonic_ns: Callable[[], int] = time.monotonic_ns,
        epoch_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        self._monotonic_ns = monotonic_ns
        self._epoch_ns = epoch_ns
        self._start_ns: int | None = None
        self._start_epoch_ns = epoch_ns()
        self.lost_us = 0

    def start(self) -> None:
        """Let time run from 0; until then it stands at 0."""
        self._start_epoch_ns = self._epoch_ns()
        self._start_ns = self._monotonic_ns()

    def now_us(self) -> int:
        """Return simulated time now [us]."""
        if self._start_ns is None:
            return 0
        return (self._monotonic_ns() - self._start_ns) // 1000 - self.lost_us

    @property
    def start_epoch_ns(self) -> int:
        """Host time at which simulated time was 0 [ns since the Unix epoch].

        Clocks of simulated devices count from it and stand still with simulated time: two of them
        that did not would drift apart by every stall of the host.
        """
        return self._start_epoch_ns

    def lose(self, lost_us: int) -> None:
        """Let simulated time be ``lost_us`` [us] further behind the host."""
        self.lost_us += lost_us

    def to_epoch_ns(self, t_us: NDArray[np.int64]) -> NDArray[np.int64]:
        """Convert simulated times [us, int64] to host time [ns since the Unix epoch, int64]."""
        return np.asarray(self._start_epoch_ns + (t_us + self.lost_us) * 1000, np.int64)
