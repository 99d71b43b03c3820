# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The container of AEDAT4 files, read and written: header, streams, packets, table of packets.

A line of text, a header as a size-prefixed FlatBuffer, then packets: stream number and size
(`int32` each) and a FlatBuffer of that size, compressed as a whole. Recorders write a table of all
packets at the end. If it is missing or incomplete, the file is scanned up to its last whole packet,
without those that are damaged
(https://docs.inivation.com/software/software-advanced-usage/file-formats/aedat-4.0.html).
"""

from __future__ import annotations

import struct
from array import array
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import lz4.frame
import numpy as np
from numpy.typing import NDArray

from mixtac_recordings import flatbuffer
from mixtac_recordings.flatbuffer import FlatBufferWriter, Octets
from mixtac_recordings.recording import (
    LARGEST_EXPANDED,
    DamagedRecordingError,
    RecordingError,
    expand,
)

MAGIC = b'#!AER-DAT4.0\r\n'
ENTRY = np.dtype(
    [('stream', '<i4'), ('size', '<i4'), ('offset', '<i8'), ('start_us', '<i8'), ('end_us', '<i8')]
)
"""A packet: its stream, bytes on disk, their position in the file, first and last time [us]."""
_LZ4 = 1
_COMPRESSIONS = {_LZ4: 'lz4', 2: 'lz4', 3: 'zstd', 4: 'zstd'}
"""Each with a number for fast and one for high compression."""
_MOST_NOTES = 10
"""Packets left out that are named; a damaged file may hold millions."""


@dataclass(frozen=True, slots=True)
class StreamInfo:
    """One stream of a file.

    Attributes:
        number: Number that its packets carry.
        identifier: What it holds: EVTS, FRME, IMUS, TRIG or another four letters.
        name: Name that the recorder gave it.
        source: Camera.
        width: Columns, 0 if not given.
        height: Rows, 0 if not given.
    """

    number: int
    identifier: str
    name: str
    source: str
    width: int
    height: int


class Aedat4File:
    """An AEDAT4 file, open for reading.

    Args:
        path: The file.

    Attributes:
        streams: Its streams.
        damage: What is missing because the file is incomplete or damaged; empty for a sound one.
            Known after `index`, but for packets that are left out later.

    Raises:
        RecordingError: It cannot be opened, is not an AEDAT4 file, or its header is damaged.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.damage = ''
        self._left_out = 0
        try:
            self._file = path.open('rb')
        except OSError as error:
            raise RecordingError(f'cannot open {path}: {error.strerror}') from error
        try:
            self._size = path.stat().st_size
            self._data_start, header = self._header()
            table = flatbuffer.root(header)
            self._compression = int(flatbuffer.column(header, table, 0, '<i4', 0)[0])
            self._table_at = int(flatbuffer.column(header, table, 1, '<i8', -1)[0])
            text = flatbuffer.structs(header, table, 2, np.dtype(np.uint8)).tobytes()
            self.streams = _streams(text)
        except DamagedRecordingError as error:
            self.close()
            raise self.damaged(str(error)) from error

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def damaged(self, what: str) -> DamagedRecordingError:
        """Return the error for a damaged file."""
        return DamagedRecordingError(
            f'{self._path} is damaged or not an AEDAT4 file ({what})',
            remedy='copy or record it again',
        )

    def index(self) -> NDArray[Any]:
        """Return all packets with content as an array of ENTRY, in the order of the file."""
        if self._table_at >= 0:
            try:
                table = self._table()
            except DamagedRecordingError:
                return self._scan()
            if len(table):
                return table
        return self._scan()

    def packet(self, entry: Any) -> Octets:  # noqa: ANN401 - an element of a structured array
        """Return the buffer of a packet, not compressed.

        Raises:
            DamagedRecordingError: The packet is damaged.
        """
        return self._expanded(self._read(int(entry['offset']), int(entry['size'])))

    def leave_out(self, offset: int, why: object) -> None:
        """Count a packet that is left out, and note the first few.

        Args:
            offset: That of its entry, where its header of 8 bytes ends.
            why: The reason.
        """
        self._left_out += 1
        if self._left_out <= _MOST_NOTES:
            self._note(f'packet at byte {offset - 8} left out ({why})')
        elif self._left_out == _MOST_NOTES + 1:
            self._note('more packets left out')

    def _note(self, text: str) -> None:
        self.damage = '; '.join(filter(None, (self.damage, text)))

    def _header(self) -> tuple[int, Octets]:
        if self._file.read(len(MAGIC)) != MAGIC:
            raise DamagedRecordingError('it does not begin with #!AER-DAT4.0')
        (size,) = struct.unpack('<I', self._read(len(MAGIC), flatbuffer.PREFIX))
        header = np.frombuffer(self._read(len(MAGIC), size + flatbuffer.PREFIX), np.uint8)
        flatbuffer.check(header, 'IOHE')
        return len(MAGIC) + len(header), header

    def _read(self, offset: int, size: int) -> bytes:
        if not (offset >= 0 and 0 <= size <= LARGEST_EXPANDED and offset + size <= self._size):
            raise DamagedRecordingError(f'{size} bytes at byte {offset} of {self._size}')
        self._file.seek(offset)
        return self._file.read(size)

    def _expanded(self, data: bytes) -> Octets:
        name = _COMPRESSIONS.get(self._compression)
        return np.frombuffer(data if name is None else expand(name, data), np.uint8)

    def _table(self) -> NDArray[Any]:
        data = self._expanded(self._read(self._table_at, self._size - self._table_at))
        flatbuffer.check(data, 'FTAB')
        rows = flatbuffer.tables(data, flatbuffer.root(data), 0)
        packets = np.zeros(len(rows), ENTRY)
        header = flatbuffer.fields(data, rows, 1)
        if (header == 0).any():
            raise DamagedRecordingError('the table of packets lacks their sizes')
        packets['stream'] = flatbuffer.values(data, header, '<i4')
        packets['size'] = flatbuffer.values(data, header + 4, '<i4')
        packets['offset'] = flatbuffer.column(data, rows, 0, '<i8', 0)
        packets['start_us'] = flatbuffer.column(data, rows, 3, '<i8', 0)
        packets['end_us'] = flatbuffer.column(data, rows, 4, '<i8', 0)
        # Some writers leave out the counts and times of all packets: none is left then.
        return packets[flatbuffer.column(data, rows, 2, '<i8', 0) > 0]

    def _scan(self) -> NDArray[Any]:
        found: list[tuple[int, int, int, int, int]] = []
        known = {stream.number: stream.identifier for stream in self.streams}
        offset = self._data_start
        end = self._table_at if offset < self._table_at < self._size else self._size
        while offset < end:
            try:
                stream, size = struct.unpack('<ii', self._read(offset, 8))
                packed = self._read(offset + 8, size)
            except DamagedRecordingError as error:
                self._note(f'the file was cut off at byte {offset} of {self._size} ({error})')
                break
            if not size:
                # A file system that lost power may leave zeros.
                self._note(f'the file was cut off at byte {offset} of {self._size} (zeros)')
                break
            try:
                times = packet_times(self._expanded(packed), known.get(stream, ''))
            except DamagedRecordingError as error:
                self.leave_out(offset + 8, error)
            else:
                if len(times):
                    found.append((stream, size, offset + 8, int(times[0]), int(times[-1])))
            offset += 8 + size
        return np.array(found, ENTRY)


EVENT = np.dtype(
    {
        'names': ['t', 'x', 'y', 'polarity'],
        'formats': ['<i8', '<u2', '<u2', np.bool_],
        'offsets': [0, 8, 10, 12],
        'itemsize': 16,
    }
)
"""An event of a packet of EVTS."""


def packet_times(data: Octets, identifier: str) -> NDArray[np.int64]:
    """Return the times [us] in a packet, none of an empty or unknown one."""
    table = flatbuffer.root(data)
    if identifier == 'FRME':
        return flatbuffer.column(data, table, 0, '<i8', 0)
    if identifier == 'EVTS':
        times: NDArray[np.int64] = flatbuffer.structs(data, table, 0, EVENT)['t']
        return times
    if identifier in {'IMUS', 'TRIG'}:
        return flatbuffer.column(data, flatbuffer.tables(data, table, 0), 0, '<i8', 0)
    return np.empty(0, np.int64)


def _streams(text: bytes) -> list[StreamInfo]:
    try:
        # The parser expands no external entities, and newer ones limit the internal.
        tree = ET.fromstring(text)  # noqa: S314
        outputs = [node for node in tree.iter('node') if node.get('name') == 'outInfo']
        return [
            _stream(node)
            for output in outputs
            for node in output.findall('node')
            if (node.get('name') or '').isdecimal()
        ]
    # Unknown encodings, and numbers of thousands of digits.
    except (ET.ParseError, LookupError, ValueError) as error:
        raise DamagedRecordingError(
            f'the description of its streams cannot be read: {error}'
        ) from error


def _stream(node: ET.Element) -> StreamInfo:
    values = {each.get('key'): each.text or '' for each in node.findall('attr')}
    for inner in node.findall("node[@name='info']"):
        values.update({each.get('key'): each.text or '' for each in inner.findall('attr')})
    width, height = (_size(values.get(key, '')) for key in ('sizeX', 'sizeY'))
    return StreamInfo(
        number=int(node.get('name') or 0),
        identifier=values.get('typeIdentifier', ''),
        name=values.get('originalOutputName', ''),
        source=values.get('source', ''),
        width=width,
        height=height,
    )


def _size(text: str) -> int:
    """Return a size in pixels, 0 for what no event can reach."""
    size = int(text) if text.isdecimal() else 0
    return size if size <= 1 << 16 else 0


STREAMS = {'EVTS': 'events', 'FRME': 'frames', 'IMUS': 'imu', 'TRIG': 'triggers'}
"""Identifiers of the streams that are written, in the order of their numbers, and their names."""


class Aedat4Writer:
    """A new AEDAT4 file, compressed with LZ4.

    Args:
        path: The new file.
        size: Columns and rows of the camera.
        camera: Its name.

    Raises:
        RecordingError: The file cannot be created.
    """

    def __init__(self, path: Path, size: tuple[int, int], camera: str) -> None:
        try:
            self._file = path.open('xb')
        except OSError as error:
            raise RecordingError(f'cannot write {path}: {error.strerror}') from error
        self._table = array('q')
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
        header = len(packed) << 32 | number
        self._table.extend((self._file.tell(), header, count, start_us, end_us))
        self._file.write(packed)

    def close(self) -> None:
        """Write the table of packets and close the file."""
        at, packets = self._file.tell(), np.array(self._table).reshape(-1, 5)
        rows = ({index: ('q', int(value)) for index, value in enumerate(each)} for each in packets)
        table = flatbuffer.tables_buffer('FTAB', rows, len(packets))
        self._file.write(lz4.frame.compress(table))
        self._file.seek(self._table_at)
        self._file.write(struct.pack('<q', at))
        self._file.close()

    def discard(self) -> None:
        """Close the file as it is."""
        self._file.close()


def _description(size: tuple[int, int], camera: str) -> str:
    nodes = ''.join(
        _stream_node(number, identifier, name, size, camera)
        for number, (identifier, name) in enumerate(STREAMS.items())
    )
    return f'<dv version="2.0">\n<node name="outInfo" path="/outInfo/">\n{nodes}</node>\n</dv>\n'


def _stream_node(
    number: int, identifier: str, name: str, size: tuple[int, int], camera: str
) -> str:
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
        f'<attr key="source" type="string">{escape(camera, quote=False)}</attr>\n</node>\n</node>\n'
    )
