# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Contact of an indenter with the viscoelastic layer on its mesh, over time.

Commands lie on a fixed grid of 125 us; a falling body is integrated in sixteenths of it. Positions
count from the free skin, inwards; the skin recovers from a dent with the times of its relaxation,
so a second contact may begin below the free skin. The state of a contact is an array: elastic force
[N], position of the indenter [mm] and its velocity [mm/s] (falling bodies only). The depth of the
dent follows from the elastic force.

The layer is quasi-linear viscoelastic: F(t) = F_e + sum_i h_i, where F_e is the elastic force of
the relaxed layer and each branch obeys dh_i/dt = -h_i / tau_i + g_i dF_e/dt. For F_e linear within
a step of length s

    h_i <- h_i exp(-s / tau_i) + g_i tau_i / s [1 - exp(-s / tau_i)] (change of F_e)

so a step is F = carried + gain * F_e with two numbers known in advance: the update is closed for
a commanded depth (F_e known) and for a commanded force (F known) alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mixtac_core.events.arrays import Floats
from mixtac_sim.grids import STEP_US
from mixtac_sim.mechanics.elastomer import ForceLaw


@dataclass(frozen=True, slots=True)
class PronySeries:
    """Relaxation of the force after a step of depth, relative to the relaxed force.

    Attributes:
        weights: g_i of each branch, non-negative.
        times_s: tau_i of each branch [s], positive.
    """

    weights: tuple[float, ...]
    times_s: tuple[float, ...]

    def update(self, step_s: float) -> Floats:
        """Return decay and gain of each branch over a step of this length [2, n]."""
        times = np.array(self.times_s)
        decay = np.exp(-step_s / times)
        return np.stack([decay, np.array(self.weights) * times / step_s * (1.0 - decay)])


@njit(cache=True, nogil=True)
def force_terms(branches: Floats, update: Floats, elastic: float) -> tuple[float, float]:
    """Return (carried, gain) of the coming step: force = carried + gain * elastic force.

    Args:
        branches: Branch forces h_i at the start of the step [n] [N].
        update: Coefficients of the step, of ``PronySeries.update``.
        elastic: Elastic force at the start of the step [N].
    """
    carried, gain = 0.0, 1.0
    for i in range(branches.size):
        carried += update[0, i] * branches[i] - update[1, i] * elastic
        gain += update[1, i]
    return carried, gain


@njit(cache=True, nogil=True)
def relax(branches: Floats, update: Floats, change: float) -> None:
    """Carry the branch forces over a step in which the elastic force changed by ``change`` [N]."""
    for i in range(branches.size):
        branches[i] = update[0, i] * branches[i] + update[1, i] * change


FALL_SUBSTEPS = 16
"""Steps of a falling body per grid step (7.8 us, a thousandth of a contact)."""
GRAVITY = 9.80665
"""Standard gravity [m/s2]."""


@njit(cache=True, nogil=True)
def _elastic(table: Floats, step: float, depth: float) -> float:
    """Return the elastic force [N] at a depth [mm]; linear beyond the table."""
    if depth <= 0.0:
        return 0.0
    k = min(int(depth / step), table.size - 2)
    return float(table[k] + (table[k + 1] - table[k]) * (depth / step - k))


@njit(cache=True, nogil=True)
def dent(table: Floats, step: float, elastic: float) -> float:
    """Return the depth [mm] of the dent that belongs to an elastic force [N]."""
    if elastic <= 0.0:
        return 0.0
    k = max(min(int(np.searchsorted(table, elastic)), table.size - 1), 1)
    return float((k - 1 + (elastic - table[k - 1]) / (table[k] - table[k - 1])) * step)


@njit(cache=True, nogil=True)
def step_force(
    state: Floats, branches: Floats, update: Floats, table: Floats, step: float, force: float
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
    state: Floats, branches: Floats, update: Floats, table: Floats, step: float, position: float
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
    state: Floats,
    branches: Floats,
    update: Floats,
    table: Floats,
    step: float,
    mass: float,
    lift: float,
) -> float:
    """Advance a grid step of a falling body; return the mean force over it [N]."""
    short = 1e-6 * STEP_US / FALL_SUBSTEPS
    total = 0.0
    velocity = float(state[2])
    for _ in range(FALL_SUBSTEPS):
        position = state[1] + velocity * short
        force = step_position(state, branches, update, table, step, position)
        velocity += 1e3 * (GRAVITY - (force + lift) / mass) * short
        total += force
    state[2] = velocity
    return float(total / FALL_SUBSTEPS)


class Mode(IntEnum):
    """Meaning of a command's target."""

    FREE = 0
    """Nothing touches; the skin recovers. The target is ignored."""
    FORCE = 1
    """Normal force [N]."""
    POSITION = 2
    """Position of the indenter from the free skin, inwards [mm]."""
    HOLD = 3
    """The indenter stays where the previous command left it. The target is ignored."""
    DROP = 4
    """The indenter's mass falls, from ``-target`` mm at the first such command."""
    LIFT = 5
    """The falling mass is also lifted by the target force [N]."""


@dataclass(frozen=True, slots=True)
class ContactPath:
    """The contact on the command grid; entry k is the state at the end of step k.

    Attributes:
        force_n: Normal force [n] [N].
        elastic_n: Elastic part of it [n] [N], which fixes the shape of the layer.
        depth_mm: Depth of the dent, layer and mesh together [n] [mm].
        position_mm: Position of the indenter [n] [mm], inwards from the free skin.
    """

    force_n: Floats
    elastic_n: Floats
    depth_mm: Floats
    position_mm: Floats


class Contact:
    """State of the contact, advanced along commands.

    Args:
        laws: Elastic force law of each indenter.
        masses_g: Mass of each indenter [g].
        prony: Relaxation of the layer.
    """

    def __init__(
        self,
        laws: Sequence[ForceLaw],
        masses_g: Sequence[float],
        prony: PronySeries,
    ) -> None:
        self._steps = np.array([law.step_mm for law in laws])
        self._tables = np.stack([law.force_n for law in laws])
        self._masses = 1e-3 * np.array(masses_g, dtype=np.float64)
        step_s = 1e-6 * STEP_US
        self._updates = np.stack([prony.update(step_s), prony.update(step_s / FALL_SUBSTEPS)])
        self._branches = np.zeros(len(prony.weights))
        self._state = np.zeros(3)
        self._last_mode = np.zeros(1, np.int8)

    def advance(
        self, modes: NDArray[np.int8], targets: Floats, indenters: NDArray[np.int8]
    ) -> ContactPath:
        """Carry out one command per grid step.

        Args:
            modes: ``Mode`` of each step [n].
            targets: Target at the end of each step [n]; its unit depends on the mode.
            indenters: Index of the indenter of each step [n].
        """
        path = np.empty((4, len(modes)))
        _advance(
            *(self._state, self._last_mode, self._branches, self._updates),
            *(self._tables, self._steps, self._masses),
            *(modes, targets, indenters, path),
        )
        return ContactPath(*path)


@njit(cache=True, nogil=True)
def _advance(
    state: Floats,
    last_mode: NDArray[np.int8],
    branches: Floats,
    updates: Floats,
    tables: Floats,
    steps: Floats,
    masses: Floats,
    modes: NDArray[np.int8],
    targets: Floats,
    indenters: NDArray[np.int8],
    path: Floats,
) -> None:
    """Carry out the commands; see ``Contact.advance``."""
    for k in range(modes.size):
        mode, tool = modes[k], indenters[k]
        table, step = tables[tool], steps[tool]
        if mode >= Mode.DROP:
            if last_mode[0] < Mode.DROP:
                state[1], state[2] = -targets[k], 0.0
            lift = targets[k] if mode == Mode.LIFT else 0.0
            force = step_fall(state, branches, updates[1], table, step, masses[tool], lift)
        elif mode == Mode.POSITION or mode == Mode.HOLD:  # noqa: PLR1714 (numba: plain compares)
            position = targets[k] if mode == Mode.POSITION else state[1]
            force = step_position(state, branches, updates[0], table, step, position)
        else:
            wanted = max(targets[k], 0.0) if mode == Mode.FORCE else 0.0
            force = step_force(state, branches, updates[0], table, step, wanted)
        last_mode[0] = mode
        path[0, k], path[1, k], path[3, k] = force, state[0], state[1]
        path[2, k] = dent(table, step, state[0])
