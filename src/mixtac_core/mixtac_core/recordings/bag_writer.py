# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Writing MCAP bags with checksums, directly or from a background thread, and repairing bags."""

from __future__ import annotations

import shutil
import struct
import threading
import zlib
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from rosbags.interfaces import (
    Connection,
    ConnectionExtRosbag2,
    MessageDefinitionFormat,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.rosbag2.errors import WriterError
from rosbags.rosbag2.storage_mcap import McapWriter

from mixtac_core.node.files import new_folder
from mixtac_core.recordings.bag import BagFile, check_new, custom_data, typestore
from mixtac_core.recordings.recording import RecordingError, reason

QUEUE_SIZE = 20_000
FLUSH_PERIOD_S = 0.02
"""Time between two turns of the writing thread: to wake it for each message costs more [s]."""
RESERVE = 1 << 26
"""Space left free for the end of a live recording: index and metadata of about 80 hours [bytes]."""
_CHECKSUM_AT = 1 + 8 + 3 * 8
"""Place of the checksum in a chunk record: after code, length, two times and a size."""


class _ChecksummedMcap(McapWriter):
    """Adds the CRC-32 of each chunk, so that readers notice flipped bytes, and flushes it."""

    def close_chunk(self) -> None:
        start, checksum = self.bio.tell(), zlib.crc32(self.chunk.bio.getbuffer())
        super().close_chunk()
        end = self.bio.tell()
        self.bio.seek(start + _CHECKSUM_AT)
        self.bio.write(struct.pack('<I', checksum))
        self.bio.seek(end)
        self.bio.flush()


class McapBag(Writer):
    """A new bag in MCAP, to be opened with `with`; see `rosbags.rosbag2.Writer`.

    Args:
        path: Folder of the new bag; must not exist.
        compressed: Compress the chunks with zstd.

    Raises:
        WriterError: The folder exists already.
    """

    STORAGE_PLUGINS = MappingProxyType({StoragePlugin.MCAP: _ChecksummedMcap})

    def __init__(self, path: Path, *, compressed: bool = False) -> None:
        super().__init__(path, version=9, storage_plugin=StoragePlugin.MCAP)
        if compressed:
            self.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)

    def add_topic(self, topic: str, type_name: str, *, latched: bool) -> Connection:
        """Announce a topic and return the handle to write it with.

        Args:
            topic: Absolute topic name.
            type_name: For example `sensor_msgs/msg/Image`.
            latched: True for transient local, as `ros2 bag play` then offers it.
        """
        return self.add_connection(
            topic,
            type_name,
            typestore=typestore(),
            offered_qos_profiles=(offered_qos(latched=latched),),
        )

    def add_like(self, connection: Connection) -> Connection:
        """Announce a topic of another bag and return the handle to write its messages with.

        A type that nobody knows, and that the other bag does not define, is kept by its name. The
        definition of a known type is that of this workspace where the other bag has none.

        Args:
            connection: The topic in the other bag.
        """
        definition, known = connection.msgdef.data, typestore()
        if connection.msgtype in known.fielddefs:
            if connection.msgdef.format is not MessageDefinitionFormat.MSG or not definition:
                definition, _ = known.generate_msgdef(connection.msgtype, ros_version=2)
            digest = known.hash_rihs01(connection.msgtype)
        else:
            digest = connection.digest or _NO_DIGEST
        extension = connection.ext
        assert isinstance(extension, ConnectionExtRosbag2)  # noqa: S101  (all bags are)
        return self.add_connection(
            connection.topic,
            connection.msgtype,
            msgdef=definition,
            rihs01=digest,
            serialization_format=extension.serialization_format,
            offered_qos_profiles=extension.offered_qos_profiles,
        )


_NO_DIGEST = f'RIHS01_{0:064}'


@dataclass(frozen=True)
class Repair:
    """Result of a repair.

    Attributes:
        counts: Messages of the new bag, by topic.
        damage: Missing parts of the old bag; empty if none are missing.
    """

    counts: dict[str, int]
    damage: str


def repair(path: Path, out: Path) -> Repair:
    """Write the intact part of a bag to a new bag.

    Args:
        path: Folder, .mcap or .db3 file.
        out: New folder.

    Raises:
        RecordingError: Nothing can be read, or the bag or a clock fit of its name exists.
        FileError: It cannot be written.
    """
    check_new(out)
    counts: dict[str, int] = {}
    with BagFile(path) as bag, new_folder(out) as made, McapBag(made) as writer:
        if bag.is_ros1:
            raise RecordingError(f'{path} is a ROS 1 bag', remedy='run `mixtac import` on it')
        writer.custom_data.update(custom_data(path))
        handles = {}
        for connection in bag.connections:
            if connection.topic not in handles:
                handles[connection.topic] = writer.add_like(connection)
        for topic, received_ns, data in bag.messages(*handles, raw=handles):
            writer.write(handles[topic], received_ns, data)
            counts[topic] = counts.get(topic, 0) + 1
        return Repair(counts, bag.damage)


def offered_qos(*, latched: bool) -> Qos:
    """Return the QoS profile to record for a topic, for `ros2 bag play`.

    Args:
        latched: True for transient local.
    """
    zero = QosTime(0, 0)
    return Qos(
        QosHistory.KEEP_LAST,
        1000,
        QosReliability.RELIABLE,
        QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE,
        zero,
        zero,
        QosLiveliness.AUTOMATIC,
        zero,
        avoid_ros_namespace_conventions=False,
    )


class BagWriter:
    """Takes messages without blocking and writes them in order.

    Messages that arrive when the queue is full are dropped and counted: a slow disk must not block
    the subscriptions. When less than
    `RESERVE` is left on the disk, nothing more is written, and the bag can be finished.

    Args:
        path: Folder of the new bag; must not exist.

    Attributes:
        written: Messages written so far, by topic.
        dropped: Messages dropped because the disk was too slow, is full or has failed.
        failure: Why nothing more is written; empty while the disk works.

    Raises:
        RecordingError: The folder or a clock fit of its name exists, or it cannot be made.
    """

    def __init__(self, path: Path) -> None:
        check_new(path)
        self.written: dict[str, int] = {}
        self.dropped = 0
        self.failure, self._broken, self._path = '', False, path
        try:
            self._writer = McapBag(path)
            self._writer.open()
        except (WriterError, OSError) as error:
            raise RecordingError(
                f'cannot record to {path}: {error}', remedy='choose a new folder with free space'
            ) from error
        self._queue: deque[tuple[Connection, int, bytes]] = deque()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._work, name='bag-writer')
        self._thread.start()

    def add_topic(self, topic: str, type_name: str, *, latched: bool) -> Connection:
        """Announce a topic and return the handle to write it with; see `McapBag.add_topic`."""
        self.written[topic] = 0
        return self._writer.add_topic(topic, type_name, latched=latched)

    def write(self, connection: Connection, timestamp: int, data: bytes) -> None:
        """Queue one serialised message, received at a host time [ns]."""
        if len(self._queue) < QUEUE_SIZE:
            self._queue.append((connection, timestamp, data))
        else:
            self.dropped += 1

    def close(self) -> None:
        """Write the queued messages and finish the bag.

        Raises:
            RecordingError: The bag could not be finished.
        """
        self._closing.set()
        self._thread.join()
        try:
            if not self._broken:
                self._writer.close()
        except OSError as error:
            self.failure, self._broken = reason(error), True
        if self._broken:
            raise RecordingError(
                f'the bag is incomplete: {self.failure}',
                remedy='free some space, and run `mixtac repair`',
            )

    def _work(self) -> None:
        while not self._closing.wait(FLUSH_PERIOD_S):
            self._flush()
        self._flush()

    def _flush(self) -> None:
        if not self.failure and shutil.disk_usage(self._path).free < RESERVE:
            self.failure = f'less than {RESERVE >> 20} MiB are left on the disk'
        while self._queue:
            connection, received_ns, data = self._queue.popleft()
            try:
                if not self.failure:
                    self._writer.write(connection, received_ns, data)
                    self.written[connection.topic] += 1
                    continue
            except (OSError, WriterError) as error:
                self.failure, self._broken = reason(error), True
            # The thread keeps emptying the queue, so that close() does not block.
            self.dropped += 1
