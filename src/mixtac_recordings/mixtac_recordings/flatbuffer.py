# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Reading and writing FlatBuffers, as far as AEDAT4 files need it.

A table begins with the distance back to its list of fields; the list holds its own size, the size
of the table, and per field its distance from the beginning of the table, 0 if the field is missing
(https://flatbuffers.dev/internals). Whole columns of a vector of tables are read at once and every
offset is checked, which the `flatbuffers` package does not do in Python. Tables are written before
the objects that they refer to, so that every offset is positive.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from mixtac_recordings.recording import DamagedRecordingError

Octets = NDArray[np.uint8]
Positions = NDArray[np.int64]


PREFIX = 4
"""Bytes of the size before a buffer."""


def check(data: Octets, identifier: str) -> None:
    """Check that a size-prefixed buffer is complete and of the expected type.

    Args:
        data: The buffer with its prefix.
        identifier: Four letters that it must carry.

    Raises:
        DamagedRecordingError: It is not.
    """
    size = int(values(data, np.array([0]), '<u4')[0])
    if size + PREFIX > len(data):
        raise DamagedRecordingError(f'a buffer of {size} bytes has only {len(data) - PREFIX}')
    found = data[8:12].tobytes()
    if found != identifier.encode():
        raise DamagedRecordingError(f'a buffer holds {found!r}, not {identifier}')


def root(data: Octets) -> Positions:
    """Return the position of the outermost table of a size-prefixed buffer, as `int64` [1]."""
    return PREFIX + values(data, np.array([PREFIX]), '<u4').astype(np.int64)


def column(
    data: Octets, tables: Positions, index: int, dtype: DTypeLike, default: float
) -> NDArray[Any]:
    """Return one field of many tables.

    Args:
        data: The buffer.
        tables: `int64` [n], positions of the tables.
        index: Number of the field in the schema.
        dtype: Little-endian type of the field.
        default: Value of tables without the field.
    """
    positions = fields(data, tables, index)
    there = positions > 0
    if there.all():
        return values(data, positions, dtype)
    column_values = np.full(len(tables), default, dtype)
    column_values[there] = values(data, positions[there], dtype)
    return column_values


def fields(data: Octets, tables: Positions, index: int) -> Positions:
    """Return the positions of a field of many tables, as `int64` [n]; 0 if it is missing."""
    lists = tables - values(data, tables, '<i4').astype(np.int64)
    size = values(data, lists, '<u2')
    slot = 4 + 2 * index
    there = size >= slot + 2
    offsets = np.zeros(len(tables), np.int64)
    offsets[there] = values(data, lists[there] + slot, '<u2')
    return np.where(offsets > 0, tables + offsets, 0)


def vector(data: Octets, table: Positions, index: int) -> tuple[int, int]:
    """Return (position of the first element, number of elements) of a field of one table."""
    where = fields(data, table, index)
    if not where[0]:
        return 0, 0
    start = where + values(data, where, '<u4').astype(np.int64)
    return int(start[0]) + 4, int(values(data, start, '<u4')[0])


def structs(data: Octets, table: Positions, index: int, dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return a vector of structs or scalars of one table as a view.

    Raises:
        DamagedRecordingError: It does not fit into the buffer.
    """
    start, count = vector(data, table, index)
    end = start + count * dtype.itemsize
    if end > len(data):
        raise DamagedRecordingError(
            f'{count} elements at byte {start} do not fit into {len(data)} bytes'
        )
    return data[start:end].view(dtype)


def tables(data: Octets, table: Positions, index: int) -> Positions:
    """Return the positions of the tables in a vector of tables of one table, as `int64` [n].

    Raises:
        DamagedRecordingError: It does not fit into the buffer.
    """
    start, count = vector(data, table, index)
    slots = start + 4 * np.arange(count, dtype=np.int64) if start + 4 * count <= len(data) else None
    if slots is None:
        raise DamagedRecordingError(
            f'{count} tables at byte {start} do not fit into {len(data)} bytes'
        )
    return slots + values(data, slots, '<u4').astype(np.int64)


def values(data: Octets, positions: Positions, dtype: DTypeLike) -> NDArray[Any]:
    """Return little-endian numbers from many positions.

    Raises:
        DamagedRecordingError: One of them is outside the buffer.
    """
    kind = np.dtype(dtype)
    last = len(data) - kind.itemsize
    if len(positions) and not (int(positions.min()) >= 0 and int(positions.max()) <= last):
        raise DamagedRecordingError(f'an offset leads out of a buffer of {len(data)} bytes')
    octets = data[positions[:, None] + np.arange(kind.itemsize)]
    found: NDArray[Any] = octets.view(kind)[:, 0]
    return found


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
        # The fields after the first four bytes begin at a multiple of 8, the widest ones first.
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

    def refer(self, at: int, target: int) -> None:
        """Set an offset at a position to a later position."""
        struct.pack_into('<I', self._data, at, target - at)

    def finish(self, root: int) -> bytes:
        """Return the buffer with a table as its root."""
        self._data += bytes(-len(self._data) % 4)
        self.refer(PREFIX, root)
        struct.pack_into('<I', self._data, 0, len(self._data) - PREFIX)
        return bytes(self._data)


def tables_buffer(
    identifier: str, rows: Iterable[Mapping[int, tuple[str, float]]], count: int
) -> bytes:
    """Return a buffer whose root table holds one vector of tables.

    Args:
        identifier: Four letters that it carries.
        rows: The tables, as for `FlatBufferWriter.table`.
        count: How many they are.
    """
    buffer = FlatBufferWriter(identifier)
    root, fields = buffer.table({0: ('O', 0)})
    vector = buffer.vector(count, bytes(4 * count))
    buffer.refer(fields[0], vector)
    for index, row in enumerate(rows, 1):
        buffer.refer(vector + 4 * index, buffer.table(row)[0])
    return buffer.finish(root)
