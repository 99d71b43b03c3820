# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Single steps of a contact under a commanded force, a commanded position or a falling mass.

The state of a contact is an array: elastic force [N], position of the indenter [mm] and its
velocity [mm/s] (falling bodies only). The depth of the dent follows from the elastic force.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from mixtac_sim.viscoelasticity import force_terms, relax

if TYPE_CHECKING:
    from numpy.typing import NDArray

STEP_US = 125
"""Spacing of the command grid [us]."""
SUBSTEPS = 16
"""Steps of a falling body per grid step (7.8 us, a thousandth of a contact)."""
GRAVITY = 9.80665
"""Standard gravity [m/s2]."""


@njit(cache=True, nogil=True)
def _elastic(table: NDArray[np.float64], step: float, depth: float) -> float:
    """Return the elastic force [N] at a depth [mm]; linear beyond the table."""
    if depth <= 0.0:
        return 0.0
    k = min(int(depth / step), table.size - 2)
    return float(table[k] + (table[k + 1] - table[k]) * (depth / step - k))


@njit(cache=True, nogil=True)
def dent(table: NDArray[np.float64], step: float, elastic: float) -> float:
    """Return the depth [mm] of the dent that belongs to an elastic force [N]."""
    if elastic <= 0.0:
        return 0.0
    k = max(min(int(np.searchsorted(table, elastic)), table.size - 1), 1)
    return float((k - 1 + (elastic - table[k - 1]) / (table[k] - table[k - 1])) * step)


@njit(cache=True, nogil=True)
def step_force(
    state: NDArray[np.float64],
    branches: NDArray[np.float64],
    update: NDArray[np.float64],
    table: NDArray[np.float64],
    step: float,
    force: float,
) -> float:
    """Advance one step under a commanded force; return the force [N]."""
    carried, gain = force_terms(branches, update, state[0])
    elastic = max((force - carried) / gain, 0.0)
    relax(branches, update, elastic - state[0])
    state[0] = elastic
    state[1] = dent(table, step, elastic)
    return force


@njit(cache=True, nogil=True)
def step_position(
    state: NDArray[np.float64],
    branches: NDArray[np.float64],
    update: NDArray[np.float64],
    table: NDArray[np.float64],
    step: float,
    position: float,
) -> float:
    """Advance one step with the indenter at a position; return the force [N], never a pull."""
    carried, gain = force_terms(branches, update, state[0])
    elastic = _elastic(table, step, position)
    force: float = carried + gain * elastic
    if position <= 0.0 or force <= 0.0:
        step_force(state, branches, update, table, step, 0.0)
        state[1] = position
        return 0.0
    relax(branches, update, elastic - state[0])
    state[0], state[1] = elastic, position
    return force


@njit(cache=True, nogil=True)
def step_fall(
    state: NDArray[np.float64],
    branches: NDArray[np.float64],
    update: NDArray[np.float64],
    table: NDArray[np.float64],
    step: float,
    mass: float,
    lift: float,
) -> float:
    """Advance a grid step of a falling body; return the mean force over it [N]."""
    short = 1e-6 * STEP_US / SUBSTEPS
    total = 0.0
    velocity = float(state[2])
    for _ in range(SUBSTEPS):
        position = state[1] + velocity * short
        force = step_position(state, branches, update, table, step, position)
        velocity += 1e3 * (GRAVITY - (force + lift) / mass) * short
        total += force
    state[2] = velocity
    return float(total / SUBSTEPS)
