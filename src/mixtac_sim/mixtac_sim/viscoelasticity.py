# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Quasi-linear viscoelasticity of the layer with an exact update per step.

The force is F(t) = F_e + sum_i h_i, where F_e is the elastic force of the relaxed layer and each
branch obeys dh_i/dt = -h_i / tau_i + g_i dF_e/dt. For F_e linear within a step of length s

    h_i <- h_i exp(-s / tau_i) + g_i tau_i / s [1 - exp(-s / tau_i)] (change of F_e)

so a step is F = carried + gain * F_e with two numbers known beforehand: the update is closed for
a commanded depth (F_e known) and for a commanded force (F known) alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from mixtac_sim.errors import SimulationError

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class PronySeries:
    """Relaxation of the force after a step of depth, relative to the relaxed force.

    Attributes:
        weights: g_i of each branch, non-negative.
        times_s: tau_i of each branch [s], positive.
    """

    weights: tuple[float, ...]
    times_s: tuple[float, ...]

    def __post_init__(self) -> None:
        """Refuse branches that do not pair up or do not relax.

        Raises:
            SimulationError: Unequal lengths, a negative weight or a time that is not positive.
        """
        paired = len(self.weights) == len(self.times_s)
        if not paired or min(self.weights) < 0.0 or min(self.times_s) <= 0.0:
            msg = (
                f'Prony series with weights {self.weights} and times {self.times_s} s; give one '
                'positive time for each non-negative weight'
            )
            raise SimulationError(msg)

    def update(self, step_s: float) -> NDArray[np.float64]:
        """Return what a step of this length needs: rows decay and gain of each branch [2, n]."""
        times = np.array(self.times_s)
        decay = np.exp(-step_s / times)
        return np.stack([decay, np.array(self.weights) * times / step_s * (1.0 - decay)])

    def loss_tangent(self, frequency_hz: float) -> float:
        """Return tan delta under a small sinusoid."""
        phase = 2.0 * np.pi * frequency_hz * np.array(self.times_s)
        weights = np.array(self.weights)
        storage = 1.0 + np.sum(weights * phase**2 / (1.0 + phase**2))
        return float(np.sum(weights * phase / (1.0 + phase**2)) / storage)


@njit(cache=True, nogil=True)
def force_terms(
    branches: NDArray[np.float64], update: NDArray[np.float64], elastic: float
) -> tuple[float, float]:
    """Return (carried, gain) of the coming step: force = carried + gain * elastic force.

    Args:
        branches: Branch forces h_i at the start of the step [n] [N].
        update: Of ``PronySeries.update`` for the length of the step.
        elastic: Elastic force at the start of the step [N].
    """
    carried, gain = 0.0, 1.0
    for i in range(branches.size):
        carried += update[0, i] * branches[i] - update[1, i] * elastic
        gain += update[1, i]
    return carried, gain


@njit(cache=True, nogil=True)
def relax(branches: NDArray[np.float64], update: NDArray[np.float64], change: float) -> None:
    """Carry the branch forces over a step in which the elastic force changed by ``change`` [N]."""
    for i in range(branches.size):
        branches[i] = update[0, i] * branches[i] + update[1, i] * change
