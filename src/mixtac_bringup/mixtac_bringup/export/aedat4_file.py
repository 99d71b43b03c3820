# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Writing AEDAT4 files: header, packets, and the table of packets at the end.

https://docs.inivation.com/software/software-advanced-usage/file-formats/aedat-4.0.html
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING
from xml.sax.saxutils import escape

import lz4.frame  # type: ignore[import-untyped]

from mixtac_bringup.errors import BagError
from mixtac_bringup.export.flatbuffer_writer import FlatBufferWriter

if TYPE_CHECKING:
    from pathlib import Path

MAGIC = b'#!AER-DAT4.0\r\n'
STREAMS = {'EVTS': 'events', 'FRME': 'frames', 'IMUS': 'imu', 'TRIG': 'triggers'}
"""Streams in the order of their numbers, with their names."""
_LZ4 = 1


class Aedat4Writer:
    """An AEDAT4 file in the making, compressed with LZ4.

    Args:
        path: The new file.
        size: Columns and rows of the camera.
        camera: Its name.

    Raises:
        BagError: The file cannot be made.
    """

    def __init__(self, path: Path, size: tuple[int, int], camera: str) -> None:
        try:
            self._file = path.open('xb')
        except OSError as error:
            raise BagError(f'cannot write {path}: {error.strerror}') from error
        self._table: list[tuple[int, int, int, int, int, int]] = []
        buffer = FlatBufferWriter('IOHE')
        root, fields = buffer.table({0: ('i', _LZ4), 1: ('q', -1), 2: ('O', 0)})
        text = _description(size, camera).encode()
        buffer.refer(fields[2], buffer.vector(len(text), text + b'\0'))
        self._file.write(MAGIC + buffer.finish(root))
        self._table_at = len(MAGIC) + fields[1]

    def write(self, stream: str, data: bytes, count: int, start_us: int, end_us: int) -> None:
        """Append a packet.

        Args:
            stream: One of `STREAMS`.
            data: Its buffer.
            count: Elements in it.
            start_us: Time of the first [us].
            end_us: Time of the last [us].
        """
        packed = lz4.frame.compress(data)
        number = list(STREAMS).index(stream)
        self._file.write(struct.pack('<ii', number, len(packed)))
        self._table.append((number, len(packed), self._file.tell(), count, start_us, end_us))
        self._file.write(packed)

    def close(self) -> None:
        """Write the table of packets and close the file."""
        at = self._file.tell()
        self._file.write(lz4.frame.compress(self._table_buffer()))
        self._file.seek(self._table_at)
        self._file.write(struct.pack('<q', at))
        self._file.close()

    def _table_buffer(self) -> bytes:
        buffer = FlatBufferWriter('FTAB')
        root, fields = buffer.table({0: ('O', 0)})
        vector, places = buffer.references(len(self._table))
        buffer.refer(fields[0], vector)
        for place, row in zip(places, self._table, strict=True):
            number, size, offset, count, start_us, end_us = row
            header = size << 32 | number
            table, _ = buffer.table(
                {
                    0: ('q', offset),
                    1: ('q', header),
                    2: ('q', count),
                    3: ('q', start_us),
                    4: ('q', end_us),
                }
            )
            buffer.refer(place, table)
        return buffer.finish(root)


def _description(size: tuple[int, int], camera: str) -> str:
    nodes = ''.join(
        _stream(number, identifier, name, size, camera)
        for number, (identifier, name) in enumerate(STREAMS.items())
    )
    return f'<dv version="2.0">\n<node name="outInfo" path="/outInfo/">\n{nodes}</node>\n</dv>\n'


def _stream(number: int, identifier: str, name: str, size: tuple[int, int], camera: str) -> str:
    values = {
        'compression': 'LZ4',
        'originalModuleName': 'mixtac',
        'originalOutputName': name,
        'typeDescription': name,
        'typeIdentifier': identifier,
    }
    sizes = ''
    if identifier in {'EVTS', 'FRME'}:
        sizes = ''.join(
            f'<attr key="{key}" type="int">{value}</attr>\n'
            for key, value in zip(('sizeX', 'sizeY'), size, strict=True)
        )
    attributes = ''.join(f'<attr key="{k}" type="string">{v}</attr>\n' for k, v in values.items())
    path = f'/outInfo/{number}/'
    return (
        f'<node name="{number}" path="{path}">\n{attributes}'
        f'<node name="info" path="{path}info/">\n{sizes}'
        f'<attr key="source" type="string">{escape(camera)}</attr>\n</node>\n</node>\n'
    )
