# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The grids on which the simulator computes, pixels and blocks of time, and its random streams.

Pixels of the DAVIS346 array are numbered row by row. Arrays over pixels are padded to whole tiles
of 64 neighbours in memory; a tile is skipped when nothing in it changes.

Commands lie on a grid of 125 us. Blocks of 4 ms are always computed whole, so the output does not
depend on how often the simulation is advanced. A block is halved until no bead moves more than
0.3 px in a step, down to 125 us.

Random streams belong to a seed, a purpose and, where time is cut up, a block. A stream depends only
on these, never on earlier draws, so results do not depend on the order or the size of the steps in
which a simulation is advanced.
"""

from __future__ import annotations

from zlib import crc32

import numpy as np
from numpy.typing import NDArray

WIDTH = 346
"""Columns (user guide)."""
HEIGHT = 260
"""Rows (user guide)."""
PITCH_MM = 0.0185
"""Pixel pitch [mm] (user guide)."""
PIXELS = WIDTH * HEIGHT
"""Pixels of the array."""
TILE = 64
"""Pixels of a tile."""
TILES = -(-PIXELS // TILE)
"""Tiles of the array."""
PADDED = TILES * TILE
"""Length of arrays over pixels."""
STEP_US = 125
"""Spacing of the command grid [us]."""
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


def stream(seed: int, purpose: str) -> np.random.Generator:
    """Return the stream of ``seed`` for one purpose, always from its beginning."""
    return np.random.default_rng([seed & 0xFFFFFFFFFFFFFFFF, crc32(purpose.encode())])


def log_uniform(rng: np.random.Generator, limits: tuple[float, float]) -> float:
    """Return a number drawn evenly in its logarithm; the lower limit if both are equal."""
    low, high = limits
    return low if low == high else float(low * (high / low) ** rng.random())


class BlockStreams:
    """Streams of one seed and purpose, addressed by a block number.

    Args:
        seed: Seed of the device or trial.
        purpose: Purpose of the numbers.
    """

    def __init__(self, seed: int, purpose: str) -> None:
        self._key = stream(seed, purpose).integers(0, 2**64, size=2, dtype=np.uint64)

    def block(self, index: int) -> np.random.Generator:
        """Return a new generator at the beginning of the stream of block ``index``."""
        return np.random.Generator(np.random.Philox(key=self._key, counter=[0, index, 0, 0]))
