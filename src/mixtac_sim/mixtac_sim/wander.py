# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A drift that saturates: an Ornstein-Uhlenbeck process, which forgets where it came from."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.random import Generator
    from numpy.typing import NDArray

KNOT_S = 1.0
"""Distance of the points between which the drift is a straight line [s]."""
BOUND = 3.0
"""Largest value in standard deviations."""


class Wander:
    """Six independent drifts of mean 0 and deviation 1, zeroed at time 0 as a bench would.

    Args:
        rng: Draws the drift; used by nothing else.
        correlation_s: Time over which it forgets [s].
    """

    def __init__(self, rng: Generator, correlation_s: float) -> None:
        self._rng = rng
        self._kept = float(np.exp(-KNOT_S / correlation_s))
        self._knots = rng.standard_normal((1, 6))

    def at(self, t_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the drift since time 0 at times from 0 on [n] [s], as [n, 6]."""
        if not len(t_s):
            return np.zeros((0, 6))
        self._extend(int(t_s.max() / KNOT_S) + 2)
        times = KNOT_S * np.arange(len(self._knots))
        bounded = np.clip(self._knots, -BOUND, BOUND)
        columns = [np.interp(t_s, times, column - column[0]) for column in bounded.T]
        return np.stack(columns, axis=1)

    def _extend(self, count: int) -> None:
        """Draw knots up to a number of them, in order, so that calls may be cut anyhow."""
        missing = count - len(self._knots)
        if missing <= 0:
            return
        steps = np.sqrt(1.0 - self._kept**2) * self._rng.standard_normal((missing, 6))
        knots = [*self._knots]
        for step in steps:
            knots.append(self._kept * knots[-1] + step)
        self._knots = np.stack(knots)
