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
        out = np.empty(min(limit & ~1, self._size), np.uint8)
        self.pop_into(out)
        return out.tobytes()

    def pop_into(self, out: NDArray[np.uint8]) -> int:
        """Move bytes to ``out`` and return how many.

        Whole words leave the ring: where ``out`` has an odd length, half of the last one is lost.
        """
        count = min(len(out) + len(out) % 2, self._size)
        first = min(count, len(self._ring) - self._start, len(out))
        size = min(count, len(out))
        out[:first] = self._ring[self._start : self._start + first]
        out[first:size] = self._ring[: size - first]
        self.drop(count)
        return size

    def drop(self, count: int) -> None:
        """Remove the oldest ``count`` bytes; there must be as many."""
        self._start = (self._start + count) % len(self._ring)
        self._size -= count
