# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Independent random streams: one per seed, purpose and, where time is cut up, block.

A stream depends only on its seed, purpose and block, never on earlier draws, so results do not
depend on the order or the size of the steps in which a simulation is advanced.
"""

from __future__ import annotations

from zlib import crc32

import numpy as np


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
        """Return the stream of block ``index``, always from its beginning."""
        return np.random.Generator(np.random.Philox(key=self._key, counter=[0, index, 0, 0]))
