# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Writing FlatBuffers: just what AEDAT4 files need (https://flatbuffers.dev/internals).

Written forwards: a table before what it refers to, so that every offset is positive.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

PREFIX = 4


class FlatBufferWriter:
    """One size-prefixed buffer.

    Args:
        identifier: Four letters that it carries.
    """

    def __init__(self, identifier: str) -> None:
        self._data = bytearray(PREFIX + 8)
        self._data[PREFIX + 4 :] = identifier.encode()

    def table(self, values: Mapping[int, tuple[str, float]]) -> tuple[int, dict[int, int]]:
        """Append a table.

        Args:
            values: Format (of `struct`, little-endian) and value by number of the field; format
                `O` leaves an offset of 4 bytes to be set by `refer`, `8s` takes bytes.

        Returns:
            Position of the table, and position of each field.
        """
        sizes = {n: 4 if f == 'O' else struct.calcsize(f) for n, (f, _) in values.items()}
        offsets, at = {}, 4
        for number in sorted(values, key=lambda n: -sizes[n]):
            offsets[number], at = at, at + sizes[number]
        count = max(values) + 1
        entries = [offsets.get(number, 0) for number in range(count)]
        vtable = struct.pack(f'<{2 + count}H', 4 + 2 * count, at, *entries)
        # Behind its first four bytes a table lies at a multiple of 8: its widest fields do as well.
        start = len(self._data) + len(vtable)
        self._data += bytes((4 - start) % 8) + vtable
        position = len(self._data)
        self._data += struct.pack('<i', len(vtable)) + bytes(at - 4)
        for number, (form, value) in values.items():
            if form != 'O':
                struct.pack_into('<' + form, self._data, position + offsets[number], value)
        return position, {number: position + offset for number, offset in offsets.items()}

    def vector(self, count: int, octets: bytes) -> int:
        """Append a vector of numbers or structs, aligned to 8, and return its position."""
        self._data += bytes((4 - len(self._data)) % 8)
        position = len(self._data)
        self._data += struct.pack('<I', count) + octets
        return position

    def references(self, count: int) -> tuple[int, list[int]]:
        """Append a vector of offsets; return its position and those of its elements."""
        position = self.vector(count, bytes(4 * count))
        return position, [position + 4 + 4 * index for index in range(count)]

    def refer(self, at: int, target: int) -> None:
        """Set an offset at a position to a later position."""
        struct.pack_into('<I', self._data, at, target - at)

    def finish(self, root: int) -> bytes:
        """Return the buffer with a table as its root."""
        self._data += bytes(-len(self._data) % 4)
        self.refer(PREFIX, root)
        struct.pack_into('<I', self._data, 0, len(self._data) - PREFIX)
        return bytes(self._data)
