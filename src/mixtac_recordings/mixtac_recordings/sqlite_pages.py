# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The rows of a cut sqlite3 bag, found in its pages without the trees that lead to them.

The library reads rows through the inner pages of a table, which may lie behind the cut, far from
the rows. Here every page that holds rows is read, in any order: a table of four columns of the
right types is that of the messages (https://sqlite.org/fileformat.html).
"""

from __future__ import annotations

import mmap
import struct
from collections.abc import Iterator
from pathlib import Path

from mixtac_recordings.recording import LARGEST_EXPANDED, DamagedRecordingError

Row = tuple[int, int, int, int]
_MAGIC = b'SQLite format 3\0'
_LEAF = 0x0D
_FIRST_PAGE_AT = 100
"""Place of the page header on the first page."""
_INTEGERS = {1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8}
"""Bytes of integers by their serial type."""


class SqlitePages:
    """An sqlite3 file as pages.

    Args:
        path: The file.

    Attributes:
        topics: Values of the columns of the topics, by number.
        rows: Number, topic, time received [ns] and place of the messages that are whole, in order
            of their numbers.

    Raises:
        DamagedRecordingError: It does not begin as an sqlite3 file.
    """

    def __init__(self, path: Path) -> None:
        with path.open('rb') as file:
            if path.stat().st_size < len(_MAGIC) or file.read(len(_MAGIC)) != _MAGIC:
                raise DamagedRecordingError('it does not begin as an sqlite3 file')
            self._data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        head = self._data[:_FIRST_PAGE_AT].ljust(_FIRST_PAGE_AT, b'\0')
        (size,) = struct.unpack_from('>H', head, 16)
        self._page = 65536 if size == 1 else size
        self._usable = self._page - head[20]
        if self._page < 512 or self._usable < 480:
            raise DamagedRecordingError(f'its pages have {self._page} bytes')
        self.topics: dict[int, list[str]] = {}
        found: dict[int, Row] = {}
        for number, at in self._cells():
            row = self._row(number, at)
            if row is not None:
                found[number] = row
        self.rows = [found[number] for number in sorted(found)]

    def close(self) -> None:
        """Close the file."""
        self._data.close()

    def message(self, row: Row) -> bytes:
        """Return the data of a message."""
        at = row[3]
        size, at = self._varint(at)
        _, at = self._varint(at)
        payload = self._payload(at, size)
        assert payload is not None  # noqa: S101  (checked when the file was opened)
        return payload[_columns(payload)[-1][1] :]

    def _cells(self) -> Iterator[tuple[int, int]]:
        """Yield number and place of every row of every table."""
        data, page = self._data, self._page
        for start in range(0, len(data) - page + 1, page):
            head = start + (_FIRST_PAGE_AT if start == 0 else 0)
            if data[head] != _LEAF:
                continue
            (count,) = struct.unpack_from('>H', data, head + 3)
            if head + 8 + 2 * count > start + page:
                continue
            for (offset,) in struct.iter_unpack('>H', data[head + 8 : head + 8 + 2 * count]):
                at = start + offset
                if 8 <= offset < page - 4:
                    _, behind = self._varint(at)
                    yield self._varint(behind)[0], at

    def _row(self, number: int, at: int) -> Row | None:
        """Return a message that is whole; note a topic."""
        size, behind = self._varint(at)
        _, behind = self._varint(behind)
        payload = self._payload(behind, size) if size <= LARGEST_EXPANDED else None
        if payload is None:
            return None
        columns = _columns(payload)
        kinds = [kind for kind, _ in columns]
        if len(kinds) == 4 and kinds[1] in _NUMBERS and kinds[2] in _NUMBERS and _is_blob(kinds[3]):
            topic, t_ns = (_integer(payload, *columns[index]) for index in (1, 2))
            return number, topic, t_ns, at
        if 4 <= len(kinds) <= 6 and all(map(_is_text, kinds[1:])):
            ends = [start for _, start in columns[2:]] + [len(payload)]
            texts = [
                payload[start:end].decode(errors='replace')
                for (_, start), end in zip(columns[1:], ends, strict=True)
            ]
            # Definitions of messages are rows of text as well.
            if texts[0].startswith('/'):
                self.topics[number] = texts
        return None

    def _payload(self, at: int, size: int) -> bytes | None:
        """Return the content of a row, None if it is not whole."""
        room, data = self._usable, self._data
        local = size
        if size > room - 35:
            least = (room - 12) * 32 // 255 - 23
            local = least + (size - least) % (room - 4)
            local = local if local <= room - 35 else least
        if at + local > len(data):
            return None
        parts, left = [data[at : at + local]], size - local
        at += local
        while left:
            if at + 4 > len(data):
                return None
            (page,) = struct.unpack_from('>I', data, at)
            at = (page - 1) * self._page
            if page == 0 or at + self._page > len(data):
                return None
            part = min(left, room - 4)
            parts.append(data[at + 4 : at + 4 + part])
            left -= part
        return b''.join(parts)

    def _varint(self, at: int) -> tuple[int, int]:
        """Return a number of variable length and the place behind it."""
        return _varint(self._data, at)


_NUMBERS = {*_INTEGERS, 8, 9}


def _varint(data: bytes | mmap.mmap, at: int) -> tuple[int, int]:
    value = 0
    for index in range(9):
        octet = data[at + index] if at + index < len(data) else 0
        if index == 8:
            return value << 8 | octet, at + 9
        value = value << 7 | octet & 0x7F
        if octet < 0x80:
            break
    return value, at + index + 1


def _columns(payload: bytes) -> list[tuple[int, int]]:
    """Return serial type and place of each column, none if the row is damaged."""
    end, at = _varint(payload, 0)
    place, found = end, []
    while at < end <= len(payload):
        kind, at = _varint(payload, at)
        found.append((kind, place))
        place += (kind - 12) // 2 if kind >= 12 else _INTEGERS.get(kind, 8 if kind == 7 else 0)
    return found if place == len(payload) else []


def _integer(payload: bytes, kind: int, at: int) -> int:
    if kind in {8, 9}:
        return kind - 8
    return int.from_bytes(payload[at : at + _INTEGERS[kind]], 'big', signed=True)


def _is_blob(kind: int) -> bool:
    return kind >= 12 and kind % 2 == 0


def _is_text(kind: int) -> bool:
    return kind >= 13 and kind % 2 == 1
