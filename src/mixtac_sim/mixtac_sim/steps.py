# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""How a block of the command grid is cut into steps of the pixels.

Blocks lie on a fixed grid of 4 ms and are always computed whole, so what comes out does not
depend on how the simulation is advanced. A block is halved until no bead moves more than 0.3 px
in a step, down to the command grid's 125 us.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mixtac_sim.contact_steps import STEP_US

if TYPE_CHECKING:
    from numpy.typing import NDArray

BLOCK_STEPS = 32
"""Grid steps per block."""
BLOCK_US = BLOCK_STEPS * STEP_US
"""Length of a block [us]."""
MOTION_PX = 0.3
"""Largest motion of any bead in a step [px]."""


def cut_block(travel_px: NDArray[np.float64], longest: int = BLOCK_STEPS) -> list[int]:
    """Return the ends of the steps of a block, in grid steps, the last being its length.

    Args:
        travel_px: Motion of the fastest bead in each grid step [n] [px].
        longest: Longest step [grid steps]: what is fast and small needs short ones, too.
    """
    ends: list[int] = []
    travelled = np.append(0.0, np.cumsum(travel_px))
    _halve(travelled, 0, len(travel_px), longest, ends)
    return ends


def _halve(
    travelled: NDArray[np.float64], first: int, last: int, longest: int, ends: list[int]
) -> None:
    slow = travelled[last] - travelled[first] <= MOTION_PX and last - first <= longest
    if last - first == 1 or slow:
        ends.append(last)
        return
    middle = (first + last) // 2
    _halve(travelled, first, middle, longest, ends)
    _halve(travelled, middle, last, longest, ends)
