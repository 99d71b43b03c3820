# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Contact of an indenter with the layer on its mesh, in time.

A fixed grid of 125 us carries every command; a falling body is integrated in sixteenths of it.
Positions count from the free skin, inwards; the skin recovers from a dent with the times of its
relaxation, so a second contact may begin below the free skin.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from mixtac_sim.contact_steps import (
    STEP_US,
    SUBSTEPS,
    dent,
    step_fall,
    step_force,
    step_position,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from mixtac_sim.elastomer import ForceLaw
    from mixtac_sim.viscoelasticity import PronySeries


class Mode(IntEnum):
    """What a command's target means."""

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
    """What happened on the command grid; entry k is the state at the end of step k.

    Attributes:
        force_n: Normal force [n] [N].
        elastic_n: Elastic part of it [n] [N], which fixes the shape of the layer.
        depth_mm: Depth of the dent, layer and mesh together [n] [mm].
        position_mm: Position of the indenter [n] [mm], inwards from the free skin.
    """

    force_n: NDArray[np.float64]
    elastic_n: NDArray[np.float64]
    depth_mm: NDArray[np.float64]
    position_mm: NDArray[np.float64]


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
        self._updates = np.stack([prony.update(step_s), prony.update(step_s / SUBSTEPS)])
        self._branches = np.zeros(len(prony.weights))
        self._state = np.zeros(3)
        self._last_mode = np.zeros(1, np.int8)

    def advance(
        self,
        modes: NDArray[np.int8],
        targets: NDArray[np.float64],
        indenters: NDArray[np.int8],
    ) -> ContactPath:
        """Carry out one command per grid step.

        Args:
            modes: ``Mode`` of each step [n].
            targets: Target at the end of each step [n]; its unit depends on the mode.
            indenters: Index of the indenter of each step [n].
        """
        path = np.empty((4, len(modes)))
        _advance(
            self._state,
            self._last_mode,
            self._branches,
            self._updates,
            self._tables,
            self._steps,
            self._masses,
            modes,
            targets,
            indenters,
            path,
        )
        return ContactPath(*path)


@njit(cache=True, nogil=True)
def _advance(
    state: NDArray[np.float64],
    last_mode: NDArray[np.int8],
    branches: NDArray[np.float64],
    updates: NDArray[np.float64],
    tables: NDArray[np.float64],
    steps: NDArray[np.float64],
    masses: NDArray[np.float64],
    modes: NDArray[np.int8],
    targets: NDArray[np.float64],
    indenters: NDArray[np.int8],
    path: NDArray[np.float64],
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
