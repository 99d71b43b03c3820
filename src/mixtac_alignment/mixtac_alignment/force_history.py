# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The reference force of the recent past, in fixed memory."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

RESTART_NS: Final = 1_000_000_000
"""A step back of the stamps beyond this is a restarted clock."""


class ForceHistory:
    """A ring of force samples with increasing stamps.

    Attributes:
        out_of_order: Samples dropped because their stamp did not increase, or their force was no
            number.
        restarts: Times the reference clock jumped back.

    Args:
        span_s: Time to remember [s].
        capacity: Most samples to remember.
    """

    def __init__(self, span_s: float, capacity: int) -> None:
        self.out_of_order = 0
        self.restarts = 0
        self._span_ns = round(span_s * 1e9)
        self._t_ns = np.zeros(capacity, np.int64)
        self._force = np.zeros((capacity, 3))
        self._count = 0

    def push(self, t_ns: int, force: tuple[float, float, float]) -> None:
        """Add a sample.

        Args:
            t_ns: Stamp, reference clock [ns].
            force: Force (x, y, z) [N].
        """
        latest = self._latest_ns()
        if latest is not None and t_ns < latest - RESTART_NS:
            self.restarts += 1
            self._count = 0
        elif (latest is not None and t_ns <= latest) or not np.isfinite(force).all():
            self.out_of_order += 1
            return
        slot = self._count % len(self._t_ns)
        self._t_ns[slot] = t_ns
        self._force[slot] = force
        self._count += 1

    def snapshot(self, axis: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return times (reference clock [s]) and forces [N] along an axis, oldest first."""
        size = len(self._t_ns)
        slots = np.arange(max(0, self._count - size), self._count) % size
        t_ns = self._t_ns[slots]
        recent = slots[t_ns >= t_ns[-1] - self._span_ns] if len(t_ns) else slots
        seconds = np.asarray(self._t_ns[recent] / 1e9, np.float64)
        return seconds, np.asarray(self._force[recent, 'xyz'.index(axis)])

    def _latest_ns(self) -> int | None:
        return int(self._t_ns[(self._count - 1) % len(self._t_ns)]) if self._count else None
