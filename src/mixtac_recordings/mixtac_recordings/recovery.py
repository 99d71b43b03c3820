# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Files of bags that are cut off or damaged, read as far as they are whole, without their index.

MCAP is read record by record (https://mcap.dev/spec): a chunk with a wrong checksum is left out,
and after a record that is not whole reading goes on at the next chunk. Topics whose announcement is
lost are taken from the end of the file. sqlite3 is read row by row, with the log of a recorder that
was killed (https://sqlite.org/wal.html).
"""

from __future__ import annotations

import mmap
import re
import shutil
import sqlite3
import struct
import sys
import tempfile
from collections import Counter
from collections.abc import Collection, Iterator
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO
from urllib.parse import quote

from rosbags.interfaces import (
    Connection,
    ConnectionExtRosbag2,
    MessageDefinition,
    MessageDefinitionFormat,
    Qos,
)
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.errors import ReaderError
from rosbags.rosbag2.metadata import ReaderMetadata, parse_qos
from rosbags.rosbag2.storage_mcap import (
    DECOMPRESSORS,
    McapReader,
    decompress,
    get_qos,
    read_bytes,
    read_exact,
    read_string,
)
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

from mixtac_recordings.recording import DamagedRecordingError, expand
from mixtac_recordings.sqlite_pages import SqlitePages

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

PACKED_SUFFIX = '.zstd'
"""Suffix of a file of a bag that is compressed as a whole."""
_DEFINITIONS = {
    'ros2msg': MessageDefinitionFormat.MSG,
    'ros2idl': MessageDefinitionFormat.IDL,
    'omgidl': MessageDefinitionFormat.IDL,
}
_MAGIC = b'\x89MCAP0\r\n'
_HEADER, _FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _DATA_END = 1, 2, 3, 4, 5, 6, 15
_RECORD = struct.Struct('<BQ')
_NEVER = (1 << 63) - 1

# The library expands chunks of any size.
DECOMPRESSORS.update({name: partial(expand, name) for name in ('lz4', 'zstd')})


def recovered(path: Path) -> tuple[Reader, str]:
    """Open what is whole of a file of a bag; return a reader of it and what is missing.

    Args:
        path: .mcap or .db3 file.

    Raises:
        ReaderError: It does not begin as such a file.
        OSError: It cannot be read.
    """
    storage = McapScan(path) if path.suffix == '.mcap' else SqliteScan(path)
    reader = Reader(path)
    reader.storage = storage
    reader.open()
    return reader, storage.damage


def unfinished(path: Path) -> bool:
    """Return whether an sqlite3 file has a log of changes that were not moved into it."""
    log = path.with_name(f'{path.name}-wal')
    return log.exists() and log.stat().st_size > 0


def shortened(path: Path) -> bool:
    """Return whether an sqlite3 file has fewer pages than its header says."""
    if path.suffix != '.db3':
        return False
    with path.open('rb') as file:
        head = file.read(100)
    if len(head) < 100:
        return True
    (page,) = struct.unpack_from('>H', head, 16)
    changed, pages, valid_for = *struct.unpack_from('>II', head, 24), head[92:96]
    counted = struct.pack('>I', changed) == valid_for
    return counted and pages * (65536 if page == 1 else page) > path.stat().st_size


def unpack(path: Path, folder: str) -> Path:
    """Expand a file that is compressed as a whole, as far as it is whole; return the new file.

    Args:
        path: The file.
        folder: For the new file, which may fill half of the free space.

    Raises:
        DamagedRecordingError: It would be larger.
    """
    out = Path(folder) / path.stem
    left = shutil.disk_usage(folder).free // 2
    with zstd.open(path, 'rb') as packed, out.open('wb') as file:
        try:
            while block := packed.read(1 << 20):
                left -= file.write(block)
                if left < 0:
                    raise DamagedRecordingError(
                        f'{path} expands to more than half of the free space in {folder}',
                        remedy='name a larger folder in TMPDIR',
                    )
        except (EOFError, zstd.ZstdError):
            pass
    return out


def temporary_folder() -> tempfile.TemporaryDirectory[str]:
    """Return a new temporary folder for files of a bag."""
    return tempfile.TemporaryDirectory(prefix='mixtac-bag-')


class McapScan(McapReader):
    """An MCAP file without its index.

    Args:
        path: The file.

    Attributes:
        damage: What is missing, empty if all records are whole. Known once it is open.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.damage = ''

    def open(self) -> None:
        """Read the whole file, check it, and note its topics and counts."""
        self.bio = bio = Path(str(self.path)).open('rb')  # noqa: SIM115  (closed by `close`)
        if bio.read(len(_MAGIC)) != _MAGIC:
            raise ReaderError('it does not begin as an MCAP file')
        notes: list[str] = []
        definitions: dict[int, tuple[str, MessageDefinition]] = {}
        found: dict[int, Connection] = {}
        counts: Counter[int] = Counter()
        start_ns, end_ns = _NEVER, 0
        for code, data in self._records(bio, notes):
            if code == _MESSAGE:
                number, t_ns = struct.unpack_from('<H4xQ', data)
                counts[number] += 1
                start_ns, end_ns = min(start_ns, t_ns), max(end_ns, t_ns)
            elif code == _SCHEMA:
                number, name, definition = _schema(data)
                definitions.setdefault(number, (name, definition))
            else:
                connection = self._channel(data, definitions)
                found.setdefault(connection.id, connection)
        self.connections = [c._replace(msgcount=counts[c.id]) for c in found.values()]
        total = sum(counts[c.id] for c in self.connections)
        if left_out := counts.total() - total:
            notes.append(f'{Path(bio.name).name} has {left_out} messages of no topic')
        self.metadata = _with_span(self.metadata, total, start_ns, end_ns)
        self.damage = '; '.join(notes)

    def messages(
        self, connections: Collection[Connection], start: int | None = None, stop: int | None = None
    ) -> Any:  # noqa: ANN401
        """Yield connection, time received [ns] and bytes of the messages, in the file's order."""
        assert self.bio is not None  # noqa: S101  (open)
        wanted = {each.id: each for each in connections}
        first, end = start or 0, _NEVER if stop is None else stop
        for code, data in self._records(self.bio, []):
            if code != _MESSAGE:
                continue
            number, t_ns = struct.unpack_from('<H4xQ', data)
            if number in wanted and first <= t_ns < end:
                yield wanted[number], t_ns, bytes(data[22:])

    def _records(self, bio: BinaryIO, notes: list[str]) -> Iterator[tuple[int, memoryview]]:
        """Yield code and content of schemas, channels and messages; note what is damaged."""
        path = Path(str(self.path))
        at, size, name = len(_MAGIC), path.stat().st_size, path.name
        summary = False
        while True:
            bio.seek(at)
            head = bio.read(_RECORD.size)
            code, length = _RECORD.unpack(head) if len(head) == _RECORD.size else (0, size)
            whole = _HEADER <= code <= _DATA_END and at + _RECORD.size + length <= size
            if code == _FOOTER or (summary and not whole):
                return
            if not whole:
                place = _next_chunk(bio, at + 1)
                if place is None and code <= _DATA_END:
                    notes.append(f'{name} was cut off: its last whole record ends at byte {at}')
                else:
                    notes.append(f'{name} is damaged from byte {at} to {place or size}')
                if place is None:
                    return
                at = place
                continue
            try:
                if code == _CHUNK:
                    yield from list(_split(_chunk(bio.read(length))))
                elif code in {_SCHEMA, _CHANNEL, _MESSAGE}:
                    yield _checked(code, memoryview(bio.read(length)))
            except (ReaderError, DamagedRecordingError, ValueError) as error:
                notes.append(f'{name} lacks {length} bytes at byte {at}: {error}')
            summary = summary or code == _DATA_END
            at += _RECORD.size + length

    def _channel(
        self, data: memoryview, definitions: dict[int, tuple[str, MessageDefinition]]
    ) -> Connection:
        record = BytesIO(data)
        number, schema = struct.unpack('<HH', record.read(4))
        topic, encoding, metadata = read_string(record), read_string(record), read_bytes(record)
        type_name, definition = definitions.get(schema, ('', _NO_DEFINITION))
        try:
            qos = get_qos(metadata)
        except (ReaderError, ValueError, KeyError, TypeError):
            qos = []
        return Connection(
            number, topic, type_name, definition, '', 0, ConnectionExtRosbag2(encoding, qos), self
        )


def _with_span(metadata: ReaderMetadata, total: int, start_ns: int, end_ns: int) -> ReaderMetadata:
    """Return metadata of a file whose messages were received in this span [ns]."""
    if not total:
        return metadata
    return metadata._replace(
        duration=end_ns - start_ns + 1,
        start_time=start_ns,
        end_time=end_ns + 1,
        message_count=total,
    )


_NO_DEFINITION = MessageDefinition(MessageDefinitionFormat.NONE, '')
_SHORTEST = {_SCHEMA: 14, _CHANNEL: 16, _MESSAGE: 22}


_CHUNK_START = re.compile(
    rb'\x06(?=(.{8}).{28}(?:\0{4}|\x03\0{3}lz4|\x04\0{3}zstd)(.{8}))', re.DOTALL
)


def _next_chunk(bio: BinaryIO, start: int) -> int | None:
    """Return where the next whole chunk begins that says its length twice; None without one."""
    with mmap.mmap(bio.fileno(), 0, access=mmap.ACCESS_READ) as data:
        for found in _CHUNK_START.finditer(data, start):
            length, packed = (int.from_bytes(each, 'little') for each in found.groups())
            end = found.start() + _RECORD.size + length
            if end == found.end(2) + packed and end <= len(data):
                return found.start()
    return None


def _schema(data: memoryview) -> tuple[int, str, MessageDefinition]:
    record = BytesIO(data)
    (number,) = struct.unpack('<H', record.read(2))
    name, encoding, content = read_string(record), read_string(record), read_bytes(record)
    form = _DEFINITIONS.get(encoding)
    definition = _NO_DEFINITION if form is None else MessageDefinition(form, content.decode())
    return number, name, definition


def _chunk(data: bytes) -> memoryview:
    record = BytesIO(data)
    size, checksum = struct.unpack('<16xQI', read_exact(record, 28))
    compression = read_string(record)
    (packed,) = struct.unpack('<Q', read_exact(record, 8))
    return memoryview(decompress(read_exact(record, packed), compression, size, checksum))


def _split(data: memoryview) -> Iterator[tuple[int, memoryview]]:
    """Yield the records of a chunk."""
    at = 0
    while at < len(data):
        if at + _RECORD.size > len(data):
            raise ReaderError('the chunk is damaged')
        code, length = _RECORD.unpack_from(data, at)
        at += _RECORD.size
        if at + length > len(data):
            raise ReaderError('the chunk is damaged')
        if code in _SHORTEST:
            yield _checked(code, data[at : at + length])
        at += length


def _checked(code: int, data: memoryview) -> tuple[int, memoryview]:
    """Return a record that can be read, or raise an error."""
    if len(data) < _SHORTEST[code]:
        raise ReaderError(f'a record of {len(data)} bytes is too short')
    if code == _SCHEMA:
        _schema(data)
    elif code == _CHANNEL:
        record = BytesIO(data[4:])
        read_string(record), read_string(record), read_bytes(record)
    return code, data


class SqliteScan(Sqlite3Reader):
    """An sqlite3 file without its index of times; one that is cut off, by its pages.

    Args:
        path: The file.

    Attributes:
        damage: What is missing, empty if all rows are whole. Known once it is open.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.damage = ''
        self._database: sqlite3.Connection | None = None
        self._pages: SqlitePages | None = None

    def open(self) -> None:
        """Read the whole file, and note its topics and counts."""
        path = Path(str(self.path))
        # The log is read only if the file counts as one that may change.
        access = 'mode=ro' if unfinished(path) else 'immutable=1'
        try:
            uri = f'file:{quote(str(path))}?{access}'
            self._database = sqlite3.connect(uri, uri=True, check_same_thread=False)
            self._note(self._topics(self._database), self._rows(0))
            (rows,) = self._database.execute('SELECT count(*) FROM messages').fetchone()
            if left_out := rows - self.metadata.message_count:
                self.damage = f'{path.name} has {left_out} rows that are messages of no topic'
        except (sqlite3.Error, ReaderError, TypeError) as error:
            self._pages = SqlitePages(path)
            self._note(self._topics_found(self._pages), self._rows(0))
            self.damage = f'{path.name} was cut off or is damaged: {error}'

    def close(self) -> None:
        """Close the file."""
        if self._pages is not None:
            self._pages.close()
        if self._database is not None:
            self._database.close()

    def messages(
        self, connections: Collection[Connection], start: int | None = None, stop: int | None = None
    ) -> Any:  # noqa: ANN401
        """Yield connection, time received [ns] and bytes of the messages, in the file's order."""
        wanted = {each.id: each for each in connections}
        first, end = start or 0, _NEVER if stop is None else stop
        for topic, t_ns, data in self._rows(first):
            if topic in wanted and first <= t_ns < end:
                yield wanted[topic], t_ns, data

    def _rows(self, start_ns: int) -> Iterator[Any]:
        """Yield topic, time received [ns] and data, at least from a time on."""
        if self._pages is None:
            assert self._database is not None  # noqa: S101  (open)
            yield from self._database.execute(
                'SELECT topic_id, timestamp, data FROM messages NOT INDEXED'
                # A column may hold values of any type.
                " WHERE typeof(topic_id) = 'integer' AND typeof(timestamp) = 'integer'"
                " AND timestamp >= 0 AND typeof(data) = 'blob' ORDER BY id"
            )
            return
        for row in self._pages.rows:
            if row[2] >= start_ns:
                yield row[1], row[2], self._pages.message(row)

    def _note(self, connections: list[Connection], rows: Iterator[Any]) -> None:
        counts: Counter[int] = Counter()
        start_ns, end_ns = _NEVER, 0
        for topic, t_ns, _ in rows:
            counts[topic] += 1
            start_ns, end_ns = min(start_ns, t_ns), max(end_ns, t_ns)
        self.connections = [c._replace(msgcount=counts[c.id]) for c in connections]
        total = sum(counts[c.id] for c in connections)
        self.metadata = _with_span(self.metadata, total, start_ns, end_ns)

    def _topics(self, database: sqlite3.Connection) -> list[Connection]:
        # The library would read pages behind the end as zeros.
        if shortened(Path(str(self.path))):
            raise ReaderError('it is shorter than its header says')
        # The rows of a view may have no end.
        tables = {
            name
            for (name,) in database.execute("SELECT name FROM sqlite_master WHERE type='table'")
        }
        if not {'topics', 'messages'} <= tables:
            raise ReaderError('it has no tables of topics and messages')
        columns = {str(row[1]) for row in database.execute('PRAGMA table_info(topics)')}
        if not {'id', 'name', 'type', 'serialization_format'} <= columns:
            raise ReaderError('it has no topics')
        qos, digest = (
            name if name in columns else "''"
            for name in ('offered_qos_profiles', 'type_description_hash')
        )
        rows: list[Any] = database.execute(
            f'SELECT id, name, type, serialization_format, {qos}, {digest} FROM topics'  # noqa: S608
        ).fetchall()
        if not all(isinstance(text, str) for row in rows for text in row[1:4]):
            raise ReaderError('its topics have no names')
        definitions = self._definitions(database) if 'message_definitions' in tables else {}
        return [self._topic(number, values, definitions) for number, *values in rows]

    def _topics_found(self, pages: SqlitePages) -> list[Connection]:
        rows = sorted(pages.topics.items())
        return [self._topic(number, [*values, '', ''], {}) for number, values in rows]

    def _topic(
        self, number: int, values: list[str], definitions: dict[str, MessageDefinition]
    ) -> Connection:
        name, kind, form, profiles, digest, *_ = values
        definition = definitions.get(kind, _NO_DEFINITION)
        extension = ConnectionExtRosbag2(form, _profiles(profiles))
        return Connection(number, name, kind, definition, digest, 0, extension, self)

    @staticmethod
    def _definitions(database: sqlite3.Connection) -> dict[str, MessageDefinition]:
        try:
            rows: list[Any] = database.execute(
                'SELECT topic_type, encoding, encoded_message_definition FROM message_definitions'
            ).fetchall()
        except sqlite3.Error:
            return {}
        return {
            kind: MessageDefinition(_DEFINITIONS[encoding], text)
            for kind, encoding, text in rows
            if encoding in _DEFINITIONS
        }


def _profiles(text: str) -> list[Qos]:
    try:
        return parse_qos(text)
    except (ReaderError, ValueError, KeyError, TypeError, AttributeError):
        return []
