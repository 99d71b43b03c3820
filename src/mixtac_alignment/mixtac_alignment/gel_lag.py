# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""How the deformation of the gel lags the force on it, as a sum of retarded responses.

The force on a layer of silicone leads its deformation: F = F_e + sum h_i with
``dh_i/dt = -h_i / tau_i + g_i dF_e/dt`` (quasi-linear viscoelasticity, Prony series). The camera
sees the deformation, which follows F_e; the clocks are aligned by the force. Expressed by the
force, F_e = F - sum w_i H_i, where H_i is the force after a high-pass filter of corner 1 / T_i.
Where a trial has impacts, the weights follow from the trial. Where it has slow motion only, a lag
of the gel and an offset of the clocks look alike; the prior `GelLag` then decides, and its
uncertainty is part of the result.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

TIMES_S: Final = (0.7e-3, 4.1e-3, 0.055, 1.05, 20.0)
"""Retardation times T_i [s] of a soft silicone with relaxation times of 0.5 and 3 ms, 0.05, 1 and
20 s."""
STRETCH: Final = 1.2
"""Step of the derivative to the logarithm of the second time."""
FINER: Final = 4
"""Points per sample: the shortest retardation is shorter than a sample of the reference."""
COLUMNS: Final = 6
"""Weights of the five responses and, third, the stretch of the second time."""


@dataclass(frozen=True, slots=True)
class GelLag:
    """Weights of the retarded responses, normally distributed.

    The order is that of `TIMES_S`, with the stretch of the second time, times its weight, third.

    Attributes:
        mean: Weights, 6.
        std: Their standard deviations, 6.
    """

    mean: tuple[float, ...] = (0.26, 0.26, 0.0, 0.035, 0.035, 0.03)
    std: tuple[float, ...] = (0.003, 0.06, 0.045, 0.012, 0.012, 0.0005)


class LaggedForce:
    """The reference force and its retarded responses, and their means over exposures.

    Args:
        t_s: Times of evenly sampled force, reference clock [s], ``float64 [n]``.
        force_N: Force [N], ``float64 [n]``.
    """

    def __init__(self, t_s: NDArray[np.float64], force_N: NDArray[np.float64]) -> None:
        from scipy.interpolate import CubicSpline

        count = len(t_s) - 1
        self._start = float(t_s[0])
        self._step = float(t_s[-1] - t_s[0]) / (count * FINER)
        spline = CubicSpline(np.arange(count + 1), force_N, bc_type='natural')
        force = spline(np.arange(count * FINER + 1) / FINER)
        change = np.diff(force, prepend=force[0])
        responses = [self._response(change, time) for time in TIMES_S]
        stretched = self._response(change, STRETCH * TIMES_S[1])
        responses.insert(2, (stretched - responses[1]) / np.log(STRETCH))
        self._values = np.stack([force, *responses])
        middle = 0.5 * self._step * (self._values[:, 1:] + self._values[:, :-1])
        self._integral = np.pad(np.cumsum(middle, axis=1), ((0, 0), (1, 0)))

    def mean(
        self, start_s: NDArray[np.float64], end_s: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return means over intervals and their change with time, each ``[m, 7]``.

        Args:
            start_s: Start of the intervals, reference clock [s], ``[m]``.
            end_s: End of the intervals, reference clock [s], ``[m]``.
        """
        span = (end_s - start_s)[:, None]
        mean = (self._at(self._integral, end_s) - self._at(self._integral, start_s)) / span
        slope = (self._at(self._values, end_s) - self._at(self._values, start_s)) / span
        return mean, slope

    def _response(self, change: NDArray[np.float64], time_s: float) -> NDArray[np.float64]:
        from scipy.signal import lfilter

        decay = float(np.exp(-self._step / time_s))
        gain = time_s / self._step * (1.0 - decay)
        return np.asarray(lfilter([gain], [1.0, -decay], change), np.float64)

    def _at(self, rows: NDArray[np.float64], t_s: NDArray[np.float64]) -> NDArray[np.float64]:
        place = (t_s - self._start) / self._step
        k = np.clip(place.astype(np.int64), 0, rows.shape[1] - 2)
        part = place - k
        return np.asarray((rows[:, k] * (1.0 - part) + rows[:, k + 1] * part).T)
