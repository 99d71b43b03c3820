# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Reading rosbag2 bags (a folder, .mcap or .db3) and the message types in them, without rclpy.

A bag that was not closed, because its recorder was killed or the disk was full, is read up to its
last complete record (https://mcap.dev/spec).
"""

from __future__ import annotations

import functools
import struct
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
from numpy.typing import NDArray
from rosbags.interfaces import Connection, Nodetype
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.errors import ReaderError
from rosbags.rosbag2.storage_mcap import McapReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from mixtac_node import topics
from mixtac_node.stamps import stamp_to_ns
from mixtac_recordings.recording import BAG_SUFFIXES, DamagedRecordingError, RecordingError

_OWN_TYPES = (
    topics.EVENTS.type_name,
    topics.CLOCK_FIT.type_name,
    topics.EXTERNAL_EDGES.type_name,
    topics.FORCE_QUALITY.type_name,
    topics.IMAGE_EXPOSURE.type_name,
    topics.SLIP.type_name,
)
"""Message types of this workspace, which rosbags does not know."""


@functools.cache
def typestore() -> Typestore:
    """Return Jazzy's standard types and those of the workspace, from their installed definitions.

    Raises:
        RecordingError: The packages that define them are not installed.
    """
    store = get_typestore(Stores.ROS2_JAZZY)
    for name in _OWN_TYPES:
        package, _, message = name.split('/')
        try:
            share = Path(get_package_share_directory(package))
        except PackageNotFoundError as error:
            raise RecordingError(
                f'bags cannot be read without {package}', remedy='source the workspace'
            ) from error
        store.register(get_types_from_msg((share / 'msg' / f'{message}.msg').read_text(), name))
    return store


def blank_message(type_name: str) -> Any:  # noqa: ANN401
    """Return a message of rosbags with all fields zero or empty, as rclpy's constructors do.

    Args:
        type_name: For example `sensor_msgs/msg/Imu`.
    """
    _, fields = typestore().fielddefs[type_name]
    blank = {name: _blank_value(*description) for name, description in fields}
    return typestore().types[type_name](**blank)


def _blank_value(node: Nodetype, content: Any) -> Any:  # noqa: ANN401
    if node == Nodetype.NAME:
        return blank_message(content)
    if node == Nodetype.BASE:
        kind = content[0]
        return {'string': '', 'bool': False}.get(kind, 0.0 if kind.startswith('float') else 0)
    (element, inner), count = content
    if element == Nodetype.NAME or inner[0] == 'string':
        return [_blank_value(element, inner) for _ in range(count)]
    kind = {'octet': 'uint8', 'byte': 'uint8', 'char': 'uint8'}.get(inner[0], inner[0])
    return np.zeros(count, kind)


class BagFile:
    """A bag, open for reading.

    Args:
        path: Folder, .mcap or .db3 file.

    Attributes:
        path: As given.
        start_ns: When the first message was received [ns, host clock of the recorder].
        duration_ns: From the first to the last message [ns].
        counts: Messages by topic.
        types: Type name by topic.
        damage: What is missing because the bag is incomplete; empty for a sound one.

    Raises:
        RecordingError: There is no bag.
        DamagedRecordingError: Nothing of it can be read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.damage = ''
        if not path.exists():
            raise RecordingError(f'no bag at {path}', remedy='give its folder, .mcap or .db3 file')
        self._types = typestore()
        try:
            self._readers = [_opened(Reader(path))]
        except Exception as error:  # noqa: BLE001  (parsers raise whatever damage leads them to)
            self._readers = self._rescued(error)
        filled = [each for each in self._readers if each.message_count]
        self.start_ns = min((each.start_time for each in filled), default=0)
        self.duration_ns = max((each.end_time for each in filled), default=0) - self.start_ns
        self.counts: dict[str, int] = {}
        self.types: dict[str, str] = {}
        for connection in self.connections:
            topic = connection.topic
            self.counts[topic] = self.counts.get(topic, 0) + connection.msgcount
            self.types[topic] = connection.msgtype

    def __enter__(self) -> BagFile:
        """Return the open bag."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the bag."""
        self.close()

    def close(self) -> None:
        """Close the files."""
        for reader in self._readers:
            if reader.is_open:
                reader.close()

    @property
    def connections(self) -> list[Connection]:
        """Return the connections of all files of the bag, with type and QoS of each topic."""
        return [connection for reader in self._readers for connection in reader.connections]

    def topics(self, type_name: str) -> list[str]:
        """Return the topics of a message type that hold any messages, sorted."""
        return sorted(t for t, kind in self.types.items() if kind == type_name and self.counts[t])

    def messages(
        self,
        *wanted: str,
        start_ns: int | None = None,
        raw: Collection[str] = (),
    ) -> Iterator[tuple[str, int, Any]]:
        """Yield (topic, time received [ns, host clock], message) in recording order.

        Args:
            wanted: Absolute topic names.
            start_ns: Begin with messages received at this time; None for the first.
            raw: Topics among `wanted` whose messages stay serialised: `bytes` in CDR.

        Raises:
            RecordingError: A topic was not recorded.
            DamagedRecordingError: The data are damaged.
        """
        missing = set(wanted) - set(self.types)
        if missing:
            listed = ', '.join(self.types) or 'no topics'
            raise RecordingError(f'{self.path} has no topic {min(missing)}; it has {listed}')
        for reader in self._readers:
            chosen = [each for each in reader.connections if each.topic in wanted]
            messages = reader.messages(chosen, start_ns) if chosen else iter(())
            while True:
                try:
                    connection, received_ns, data = next(messages)
                    message = (
                        data
                        if connection.topic in raw
                        else self._types.deserialize_cdr(data, connection.msgtype)
                    )
                except StopIteration:
                    break
                except Exception as error:  # as above
                    raise self._damaged(error) from error
                yield connection.topic, received_ns, message

    def wrenches(self, topic: str) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return the stamps [ns, the topic's own clock] and normal forces [N] of a topic."""
        stamps, forces = [], []
        for _, _, message in self.messages(topic):
            stamps.append(stamp_to_ns(message.header.stamp))
            forces.append(topics.normal_force(message))
        return np.array(stamps, np.int64), np.array(forces, np.float64)

    def _rescued(self, error: Exception) -> list[Reader]:
        """Open the files of the bag one by one and note in `damage` what is missing."""
        found = [p for p in self.path.glob('*') if p.suffix in BAG_SUFFIXES]
        # In the order of their numbers, which have no leading zeros.
        found.sort(key=lambda each: (len(each.name), each.name))
        if self.path.is_dir() and not found:
            raise self._damaged(error) from error
        there = not self.path.is_dir() or (self.path / 'metadata.yaml').exists()
        readers, notes = [], [] if there else ['metadata.yaml is missing']
        for path in found or [self.path]:
            try:
                readers.append(_opened(Reader(path)))
            except Exception as wrong:  # noqa: BLE001  (as above)
                try:
                    readers.append(_opened_incomplete(path))
                    notes.append(f'{path.name} ends early')
                except Exception:  # noqa: BLE001  (as above)
                    notes.append(f'{path.name}: {_text(wrong)}')
        if not any(reader.message_count for reader in readers):
            raise self._damaged(error) from error
        read = sum(reader.message_count for reader in readers)
        notes = notes or [f'metadata.yaml cannot be used: {_text(error)}']
        self.damage = f'the bag is incomplete ({"; ".join(notes)}): {read} messages can be read'
        return readers

    def _damaged(self, error: Exception) -> DamagedRecordingError:
        return DamagedRecordingError(
            f'{self.path} is damaged or not a bag ({_text(error)})',
            remedy='copy or record it again',
        )


def _text(error: Exception) -> str:
    return ' '.join(str(error).split()) or type(error).__name__


def _opened(reader: Reader) -> Reader:
    reader.open()
    return reader


def _opened_incomplete(path: Path) -> Reader:
    reader = Reader(path)
    reader.storage = _IncompleteMcap(path)
    return _opened(reader)


class _IncompleteMcap(McapReader):
    """An MCAP file without its end, read up to the last complete record."""

    _MAGIC = b'\x89MCAP0\r\n'
    _END_OF_DATA = (0x00, 0x02, 0x0F)

    def open(self) -> None:
        self.bio = bio = Path(str(self.path)).open('rb')  # noqa: SIM115  (closed by `close`)
        if bio.read(len(self._MAGIC)) != self._MAGIC:
            raise ReaderError('it does not begin as an MCAP file')
        self.data_start, self.data_end = len(self._MAGIC), self._complete(bio)
        self.meta_scan()
        found = self.statistics
        assert found is not None  # noqa: S101  (set by meta_scan)
        counts = found.channel_message_counts
        self.connections = [
            each._replace(msgcount=counts.get(each.id, 0)) for each in self.connections
        ]
        self.metadata = self.metadata._replace(
            duration=found.end_time - found.start_time + 1,
            start_time=found.start_time,
            end_time=found.end_time + 1,
            message_count=found.message_count,
        )

    def messages(
        self, connections: Collection[Connection], start: int | None = None, stop: int | None = None
    ) -> Any:  # noqa: ANN401
        # The base class refuses unsorted messages without an index.
        return self.messages_scan(connections, start, stop)

    def _complete(self, bio: BinaryIO) -> int:
        """Return where the last complete record ends."""
        at, size = bio.tell(), self.path.stat().st_size
        while at + 9 <= size:
            bio.seek(at)
            code, length = struct.unpack('<BQ', bio.read(9))
            if code in self._END_OF_DATA or at + 9 + length > size:
                break
            at += 9 + length
        return at
