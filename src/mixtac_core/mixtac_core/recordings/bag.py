# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Read bags of ROS 2 (folder, .mcap, .db3) and ROS 1 (.bag) and their types, without rclpy.

MCAP files are read chunk by chunk, so that damage affects only the chunks that it hit: a chunk with
a wrong checksum is skipped, a truncated file is read up to the cut.
"""

from __future__ import annotations

import contextlib
import functools
import os
import tempfile
from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, DataEnd, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from numpy.typing import NDArray
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinition
from rosbags.interfaces import MessageDefinitionFormat as Format
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.metadata import parse_qos
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from mixtac_core.node import topics
from mixtac_core.node.files import FileError, read_data, share
from mixtac_core.node.topics import stamp_to_ns
from mixtac_core.recordings.recording import (
    BAG_SUFFIXES,
    ROS1_SUFFIX,
    ZSTD,
    DamagedRecordingError,
    RecordingError,
    not_a_recording,
    reason,
)


@functools.cache
def typestore() -> Typestore:
    """Return Jazzy's standard types and those of the workspace, from their installed definitions.

    Raises:
        ShareError: The packages that define them are not installed.
    """
    store = get_typestore(Stores.ROS2_JAZZY)
    for name in sorted({topic.type_name for topic in topics.TOPICS} - store.types.keys()):
        package, _, message = name.split('/')
        text = (share(package) / 'msg' / f'{message}.msg').read_text()
        store.register(get_types_from_msg(text, name))
    return store


ZEROS = 4096
"""More than the fields of any message take without the content of sequences [bytes]."""


def blank_message(type_name: str) -> Any:  # noqa: ANN401
    """Return a message of rosbags with all fields zero or empty, as rclpy's constructors do.

    Args:
        type_name: For example `sensor_msgs/msg/Imu`.
    """
    types, definition = typestore(), typestore().get_msgdef(type_name)
    # Read from zeros, in the format of ROS 1, whose texts may be empty.
    message, _ = definition.deserialize_ros1(memoryview(bytearray(ZEROS)), 0, definition.cls, types)
    return message


class BagFile(contextlib.ExitStack[None]):
    """A bag, open for reading until `close` or the end of a `with` block.

    Args:
        path: Folder, .mcap, .db3 or .bag file.

    Attributes:
        path: As given.
        is_ros1: Whether messages are serialised as ROS 1 does, instead of in CDR.
        connections: Type and QoS of each topic, of each of its files.
        start_ns: When the first message was received [ns, host clock of the recorder].
        duration_ns: From the first to the last message [ns].
        counts: Messages by topic.
        types: Type name by topic.

    Raises:
        RecordingError: There is no bag.
        DamagedRecordingError: Nothing of it can be read.
    """

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.path = path
        self.is_ros1 = path.suffix == ROS1_SUFFIX and path.is_file()
        if not path.exists():
            raise RecordingError(f'no bag at {path}', remedy='give its folder, .mcap or .db3 file')
        self._readers: list[Any] = []
        self._missing: list[str] = []
        try:
            self._open()
        except BaseException:
            self.close()
            raise
        filled = [each for each in self._readers if each.message_count]
        self.start_ns = min((each.start_time for each in filled), default=0)
        self.duration_ns = max((each.end_time for each in filled), default=0) - self.start_ns
        self.connections: list[Connection] = [c for each in self._readers for c in each.connections]
        self.counts: Counter[str] = Counter()
        self.types: dict[str, str] = {}
        for each in self.connections:
            self.counts[each.topic] += each.msgcount
            self.types[each.topic] = each.msgtype

    @property
    def damage(self) -> str:
        """What is missing because the bag is incomplete, as far as it has been read; else empty."""
        scans = [each for each in self._readers if isinstance(each, McapFile)]
        notes = [note for scan in scans for _, note in sorted(scan.notes.items())]
        text = '; '.join(self._missing + notes)
        return f'the bag is incomplete: {text}' if text else ''

    def topics(self, *type_names: str) -> list[str]:
        """Return the topics of some message types that hold any messages, sorted."""
        return sorted(t for t, kind in self.types.items() if kind in type_names and self.counts[t])

    def messages(self, *wanted: str, raw: Collection[str] = ()) -> Iterator[tuple[str, int, Any]]:
        """Yield (topic, time received [ns, host clock], message) in recording order.

        Args:
            wanted: Absolute topic names.
            raw: Topics among `wanted` whose messages stay serialised: `bytes`, see `is_ros1`.

        Raises:
            RecordingError: A topic was not recorded.
            DamagedRecordingError: The data are damaged.
        """
        if missing := set(wanted) - set(self.types):
            listed = ', '.join(self.types) or 'no topics'
            raise RecordingError(f'{self.path} has no topic {min(missing)}; it has {listed}')
        for reader in self._readers:
            chosen = [each for each in reader.connections if each.topic in wanted]
            read = reader.deserialize if self.is_ros1 else typestore().deserialize_cdr
            try:
                for each, received_ns, data in reader.messages(chosen) if chosen else ():
                    # Compressed one by one; others begin with a zero.
                    plain = _expand(data) if data[:4] == ZSTD.magic else data
                    message = plain if each.topic in raw else read(plain, each.msgtype)
                    yield each.topic, received_ns, message
            except Exception as error:  # the parsers raise whatever damage leads them to
                raise self._damaged(error) from error

    def wrenches(self, topic: str) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return the wrenches of a topic.

        Returns:
            Stamps [ns, clock of the topic], [n], and force [N] and torque [N m], [n, 6].
        """
        table = np.fromiter(
            ((stamp_to_ns(m.header.stamp), _SIX(m.wrench)) for _, _, m in self.messages(topic)),
            np.dtype([('t', np.int64), ('wrench', np.float64, 6)]),
        )
        return table['t'], table['wrench']

    def _open(self) -> None:
        """Open the files of the bag, in the order of their first messages."""
        folder = self.path if self.path.is_dir() else None
        files = sorted(filter(is_storage, folder.iterdir())) if folder else [self.path]
        if not files or not is_bag(files[0]):
            raise not_a_recording(self.path)
        facts = _facts(folder) if folder else {}
        named = {Path(str(each)).name for each in facts.get('relative_file_paths') or ()}
        lost = sorted(named - {each.name for each in files})
        self._missing += [f'missing files: {", ".join(lost)}'] if lost else []
        cause: Exception | None = None
        for path in files:
            try:
                self._readers.append(self._opened(path))
            except Exception as error:  # noqa: BLE001  (as in `messages`)
                cause = error
                self._missing.append(f'{path.name} cannot be read: {reason(error)}')
        if cause is not None and not any(each.message_count for each in self._readers):
            raise self._damaged(cause) from cause
        self._readers.sort(key=lambda each: each.start_time)

    def _opened(self, path: Path) -> Any:  # noqa: ANN401  (a reader of rosbags, or one like it)
        """Open a file of the bag."""
        if path.suffix == '.zstd':
            folder = self.enter_context(tempfile.TemporaryDirectory(prefix='mixtac_'))
            expanded = Path(folder) / path.stem
            with path.open('rb') as source, expanded.open('wb') as file:
                zstandard.ZstdDecompressor().copy_stream(source, file)
            path = expanded
        if path.suffix == '.mcap':
            return McapFile(path)
        log = path.with_name(f'{path.name}-wal')
        if log.exists() and log.stat().st_size:
            raise RecordingError(
                f'{path.name} was not closed: its last messages are in {log.name}',
                remedy=f"run: sqlite3 '{path}' 'PRAGMA wal_checkpoint(TRUNCATE)'",
            )
        reader = AnyReader([path]) if self.is_ros1 else Reader(path)
        reader.open()
        self.callback(reader.close)
        return reader

    def _damaged(self, error: Exception) -> DamagedRecordingError:
        if isinstance(error, RecordingError) and error.remedy:
            return DamagedRecordingError(f'{self.path}: {error.message}', remedy=error.remedy)
        remedy = 'copy it again, or try `mixtac repair`'
        if self.is_ros1:
            remedy = 'copy it again, or run `rosbag reindex` of ROS 1'
        elif databases := [p for p in (self.path, *self.path.glob('*.db3')) if p.suffix == '.db3']:
            name = databases[0]
            remedy = f"copy it again, or run: sqlite3 '{name}' .recover | sqlite3 recovered.db3"
        return DamagedRecordingError(
            f'{self.path} is damaged or not a bag ({reason(error)})', remedy=remedy
        )


def _expand(data: bytes) -> bytes:
    return zstandard.ZstdDecompressor().decompressobj().decompress(data)


_SIX = attrgetter('force.x', 'force.y', 'force.z', 'torque.x', 'torque.y', 'torque.z')


class McapFile:
    """An MCAP file, with the attributes and methods of a reader of rosbags that `BagFile` uses.

    Messages of a chunk are in order of their reception. The index gives the number of messages;
    without an index, the messages are counted once.

    Args:
        path: The file.

    Attributes:
        connections: Its topics, with their numbers of messages.
        message_count: Number of messages.
        start_time: When the first one was received [ns, host clock of the recorder].
        end_time: When the last one was received, and 1 ns.
        notes: What is missing, by place; grows while messages are read.

    Raises:
        DamagedRecordingError: Nothing can be read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.notes: dict[int, str] = {}
        self._schemas: dict[int, Schema] = {}
        try:
            with path.open('rb') as file:
                summary = SeekingReader(file).get_summary()
        except Exception:  # noqa: BLE001  (the parser raises whatever damage leads it to)
            summary = None
            # A file that was closed ends with a footer, with statistics or without.
            self.notes[0] = f'{path.name} was not closed'
        if summary and summary.statistics:
            found, channels, self._schemas = summary.statistics, summary.channels, summary.schemas
            counts = Counter(found.channel_message_counts)
            self.start_time, self.end_time = found.message_start_time, found.message_end_time + 1
        else:
            channels, counts = self._count()
        self.connections = [self._connection(each, counts[key]) for key, each in channels.items()]
        self.message_count = sum(each.msgcount for each in self.connections)

    def messages(
        self, connections: Collection[Connection]
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """Yield topic, time received [ns] and CDR of the messages of some topics."""
        wanted = {each.id: each for each in connections}
        for record in self._records():
            if isinstance(record, Message) and record.channel_id in wanted:
                yield wanted[record.channel_id], record.log_time, record.data

    def _count(self) -> tuple[dict[int, Channel], Counter[int]]:
        """Read the whole file for what its index would say.

        Raises:
            DamagedRecordingError: Nothing can be read.
        """
        channels: dict[int, Channel] = {}
        counts: Counter[int] = Counter()
        times = []
        for record in self._records():
            if isinstance(record, Schema):
                self._schemas.setdefault(record.id, record)
            elif isinstance(record, Channel):
                channels.setdefault(record.id, record)
            elif isinstance(record, Message):
                counts[record.channel_id] += 1
                times.append(record.log_time)
        if not channels:
            raise DamagedRecordingError('; '.join(self.notes.values()) or 'it holds no topics')
        self.start_time, self.end_time = min(times, default=0), max(times, default=-1) + 1
        return channels, counts

    def _records(self) -> Iterator[Any]:
        """Yield schemas, channels and messages; note what is damaged."""
        name, size, at = self.path.name, self.path.stat().st_size, 0
        with self.path.open('rb') as file:
            try:
                for record in StreamReader(file, emit_chunks=True, record_size_limit=size).records:
                    if isinstance(record, DataEnd):
                        return
                    yield from self._inside(record, at) if isinstance(record, Chunk) else (record,)
                    at = file.tell()
            except Exception as error:  # noqa: BLE001  (as above)
                self.notes[at] = f'{name} ends or is damaged at byte {at} ({reason(error)})'

    def _inside(self, chunk: Chunk, at: int) -> list[Any]:
        """Return the records of a chunk: schemas and channels first, which have no time."""
        try:
            inside = breakup_chunk(chunk, validate_crc=True)
        except Exception as error:  # noqa: BLE001  (as above)
            self.notes[at] = f'{self.path.name} lacks a chunk at byte {at} ({reason(error)})'
            return []
        return sorted(inside, key=lambda each: getattr(each, 'log_time', -1))

    def _connection(self, channel: Channel, count: int) -> Connection:
        schema = self._schemas.get(channel.schema_id)
        known = schema is not None and schema.encoding in {'ros2msg', 'ros2idl'}
        text = schema.data.decode(errors='replace') if schema and known else ''
        try:
            profiles = parse_qos(channel.metadata.get('offered_qos_profiles', ''))
        except Exception:  # noqa: BLE001  (as above)
            profiles = []
        return Connection(
            channel.id,
            channel.topic,
            schema.name if schema else '',
            MessageDefinition(Format.MSG, text),
            channel.metadata.get('topic_type_hash', ''),
            count,
            ConnectionExtRosbag2(channel.message_encoding, profiles),
            self,
        )


def is_storage(path: Path) -> bool:
    """Return whether a file is one of a ROS 2 bag by its name, compressed as a whole or not."""
    name = Path(path.stem) if path.suffix == '.zstd' else path
    return name.suffix in BAG_SUFFIXES


def is_bag(path: Path) -> bool:
    """Return whether a path is that of a bag: a folder with its files, or a file by its name."""
    if path.is_dir():
        return (path / 'metadata.yaml').exists() or any(map(is_storage, path.iterdir()))
    return is_storage(path) or path.suffix == ROS1_SUFFIX


def _facts(bag: Path) -> dict[str, Any]:
    """Return the content of metadata.yaml; empty if it cannot be read."""
    try:
        return dict(read_data(bag / 'metadata.yaml')['rosbag2_bagfile_information'])
    except (FileError, KeyError, TypeError, ValueError):
        return {}


def custom_data(bag: Path) -> dict[str, str]:
    """Return what metadata.yaml says of a bag by keys of its writer; empty if it cannot be read."""
    return dict(_facts(bag).get('custom_data') or {})


def fit_path(bag: Path) -> Path:
    """Return where the clock fit of a bag lies."""
    return bag.parent / f'{bag.name}.clock_fit.json'


def check_new(bag: Path) -> None:
    """Check that a bag can be made: a clock fit of an earlier one would count for it.

    Raises:
        RecordingError: The bag or a fit of its name exists.
    """
    for path in (bag, fit_path(bag)):
        if path.exists():
            raise RecordingError(f'{path} exists', remedy='remove it, or name a new folder')


def find_bags(path: Path, depth: int = 3) -> list[Path]:
    """Return a bag itself, or the bags in a folder and its folders in the order of their names.

    A bag that was cut off has its data but no metadata.yaml; hidden folders are left out. Bags
    have names; for `.` and `..` the name of the folder is looked up.

    Args:
        path: Bag, or folder.
        depth: Levels of folders to look into; 0 takes only a bag itself.
    """
    if path.is_file() or (path.is_dir() and is_bag(path)):
        return [path.resolve() if path.name in {'', '..'} else path]
    inside = sorted(path.iterdir()) if path.is_dir() and depth else ()
    folders = (each for each in inside if each.is_dir() and each.name[0] != '.')
    return [bag for each in folders for bag in find_bags(each, depth - 1)]


def distinct_names(bags: Iterable[Path]) -> dict[Path, str]:
    """Return a name of each bag: its own, or its path in their common folder if names repeat."""
    paths = {bag: bag.absolute() for bag in bags}
    if len({path.name for path in paths.values()}) == len(paths):
        return {bag: path.name for bag, path in paths.items()}
    common = os.path.commonpath([path.parent for path in paths.values()])
    return {bag: '_'.join(path.relative_to(common).parts) for bag, path in paths.items()}
