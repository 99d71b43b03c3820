# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The camera's bounded output buffer, a ring of bytes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


class ByteFifo:
    """A first-in first-out ring of bytes. Not thread safe: the device guards it.

    Args:
        capacity: Size [bytes].
    """

    def __init__(self, capacity: int) -> None:
        self._ring = np.zeros(capacity, np.uint8)
        self._start = 0
        self._size = 0

    def __len__(self) -> int:
        """Return how many bytes wait."""
        return self._size

    @property
    def free(self) -> int:
        """How many more bytes fit."""
        return len(self._ring) - self._size

    def clear(self) -> None:
        """Forget everything."""
        self._start = self._size = 0

    def push(self, words: NDArray[np.uint16]) -> bool:
        """Append words, little-endian; all or nothing.

        Returns:
            Whether they fitted.
        """
        data = np.ascontiguousarray(words, '<u2').view(np.uint8)
        if len(data) > self.free:
            return False
        at = (self._start + self._size) % len(self._ring)
        first = min(len(data), len(self._ring) - at)
        self._ring[at : at + first] = data[:first]
        self._ring[: len(data) - first] = data[first:]
        self._size += len(data)
        return True

    def pop(self, limit: int) -> bytes:
        """Remove and return at most ``limit`` bytes, whole words only."""
        count = min(limit & ~1, self._size)
        first = min(count, len(self._ring) - self._start)
        head = self._ring[self._start : self._start + first].tobytes()
        if first < count:
            head += self._ring[: count - first].tobytes()
        self._start = (self._start + count) % len(self._ring)
        self._size -= count
        return head
