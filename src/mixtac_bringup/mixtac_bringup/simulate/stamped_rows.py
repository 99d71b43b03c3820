# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Many messages of one size at once: those that differ in the stamp and in trailing numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

NS = 1_000_000_000
_STAMP_AT = 4
"""After CDR's four bytes that name the byte order."""


class StampedRows:
    """Serialises messages that begin with a header and end with doubles.

    Args:
        example: One such message in little-endian CDR; all else is taken from it.
        numbers: How many doubles it ends with.
    """

    def __init__(self, example: bytes, numbers: int) -> None:
        self._example = example
        self._layout = np.dtype(
            {
                'names': ['sec', 'nanosec', 'numbers'],
                'formats': ['<i4', '<u4', ('<f8', numbers)],
                'offsets': [_STAMP_AT, _STAMP_AT + 4, len(example) - 8 * numbers],
                'itemsize': len(example),
            }
        )

    @property
    def numbers(self) -> NDArray[np.float64]:
        """Return the doubles of the example."""
        row = np.frombuffer(self._example, self._layout)[0]
        return np.array(row['numbers'], np.float64)

    def make(self, stamp_ns: NDArray[np.int64], numbers: NDArray[np.float64]) -> list[bytes]:
        """Return one message per row.

        Args:
            stamp_ns: Stamps [n] [ns].
            numbers: The doubles [n, numbers].
        """
        octets = bytearray(self._example * len(stamp_ns))
        rows = np.frombuffer(octets, self._layout)
        rows['sec'], rows['nanosec'] = stamp_ns // NS, stamp_ns % NS
        rows['numbers'] = numbers
        size = len(self._example)
        return [bytes(octets[i : i + size]) for i in range(0, len(octets), size)]
