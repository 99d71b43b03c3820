# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Time kept over data that had to be thrown away."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numba import njit

if TYPE_CHECKING:
    from array import array

    from numpy.typing import NDArray

    Octets = bytes | bytearray | memoryview | array[int] | NDArray[Any]


@dataclass(frozen=True, slots=True)
class Gap:
    """Data that were lost between two transfers.

    Attributes:
        size: Bytes lost.
        wraps: Wraps of the 15-bit time among them, since the last reset among them.
        resets: Resets of the clock among them.
    """

    size: int = 0
    wraps: int = 0
    resets: int = 0

    def __add__(self, later: Gap) -> Gap:
        """Return this gap and the one after it as one."""
        wraps = later.wraps if later.resets else self.wraps + later.wraps
        return Gap(self.size + later.size, wraps, self.resets + later.resets)


@njit(cache=True, nogil=True)
def _count(words: Any) -> tuple[int, int]:  # noqa: ANN401
    wraps = resets = 0
    for word in words:
        if word >> 12 == 7:
            wraps += word & 0xFFF
        elif word == 1:
            resets += 1
            wraps = 0
    return wraps, resets


def gap_of(data: Octets) -> Gap:
    """Return the gap that throwing these bytes away leaves."""
    octets = np.frombuffer(data, np.uint8)
    wraps, resets = _count(octets[: len(octets) // 2 * 2].view('<u2'))
    return Gap(len(octets), int(wraps), int(resets))
