# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Writing MCAP bags with checksums, directly or from a background thread, and repairing bags."""

from __future__ import annotations

import shutil
import struct
import threading
import zlib
from collections import Counter, deque
from pathlib import Path
from types import MappingProxyType

from rosbags.interfaces import Connection
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.rosbag2.errors import WriterError
from rosbags.rosbag2.metadata import parse_qos
from rosbags.rosbag2.storage_mcap import McapWriter

from mixtac_core.node.files import new_folder
from mixtac_core.recordings.bag import BagFile, check_new, custom_data, typestore
from mixtac_core.recordings.recording import RecordingError, reason

QUEUE_SIZE = 20_000
FLUSH_PERIOD_S = 0.02
"""Time between two turns of the writing thread: to wake it for each message costs more [s]."""
RESERVE = 1 << 26
"""Space left free for the end of a live recording: index and metadata of about 80 hours [bytes]."""
QOS = """- {history: keep_last, depth: 1000, reliability: reliable, durability: DURABILITY,
  deadline: {sec: 0, nsec: 0}, lifespan: {sec: 0, nsec: 0}, liveliness: automatic,
  liveliness_lease_duration: {sec: 0, nsec: 0}, avoid_ros_namespace_conventions: false}"""
"""Quality of service of a topic, as bags hold it."""
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
        qos = parse_qos(QOS.replace('DURABILITY', 'transient_local' if latched else 'volatile'))
        types = typestore()
        return self.add_connection(topic, type_name, typestore=types, offered_qos_profiles=qos)

    def add_topics_of(self, bag: BagFile, without: str = '') -> dict[str, Connection]:
        """Announce the topics of another bag, and copy the custom data of its writer.

        A definition that the other bag lacks is that of this workspace; without one, the type is
        kept by its name.

        Args:
            bag: The other bag.
            without: Topic to leave out.

        Returns:
            Handles to write messages with, by topic.

        Raises:
            RecordingError: The other bag is of ROS 1.
        """
        if bag.is_ros1:
            raise RecordingError(f'{bag.path} is a ROS 1 bag', remedy='run `mixtac import` on it')
        self.custom_data.update(custom_data(bag.path))
        handles: dict[str, Connection] = {}
        for each in bag.connections:
            if each.topic in {without, *handles}:
                continue
            definition, known = each.msgdef.data, typestore()
            digest = each.digest or f'RIHS01_{0:064}'
            if each.msgtype in known.fielddefs:
                definition = definition or known.generate_msgdef(each.msgtype, ros_version=2)[0]
                digest = known.hash_rihs01(each.msgtype)
            handles[each.topic] = self.add_connection(
                each.topic,
                each.msgtype,
                msgdef=definition,
                rihs01=digest,
                **each.ext._asdict(),
            )
        return handles


def repair(path: Path, out: Path) -> tuple[Counter[str], str]:
    """Write the intact part of a bag to a new bag.

    Args:
        path: Folder, .mcap or .db3 file.
        out: New folder.

    Returns:
        Messages of the new bag by topic, and the missing parts of the old bag; empty if none.

    Raises:
        RecordingError: Nothing can be read, or the bag or a clock fit of its name exists.
        FileError: It cannot be written.
    """
    check_new(out)
    counts: Counter[str] = Counter()
    with BagFile(path) as bag, new_folder(out) as made, McapBag(made) as writer:
        handles = writer.add_topics_of(bag)
        for topic, received_ns, data in bag.messages(*handles, raw=handles):
            writer.write(handles[topic], received_ns, data)
            counts[topic] += 1
        return counts, bag.damage


class BagWriter:
    """Takes messages without blocking and writes them in order.

    Messages that arrive when the queue is full are dropped and counted: a slow disk must not block
    the subscriptions. When less than `RESERVE` is left on the disk, nothing more is written, and
    the bag can be finished.

    Args:
        path: Folder of the new bag; must not exist.

    Attributes:
        dropped: Messages dropped because the disk was too slow, is full or has failed.
        failure: Why nothing more is written; empty while the disk works.

    Raises:
        RecordingError: The folder or a clock fit of its name exists, or it cannot be made.
    """

    def __init__(self, path: Path) -> None:
        check_new(path)
        self.dropped, self.failure, self._broken, self._path = 0, '', False, path
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
        closing = False
        while not closing:
            closing = self._closing.wait(FLUSH_PERIOD_S)
            while self._queue:
                if not self.failure and shutil.disk_usage(self._path).free < RESERVE:
                    self.failure = f'less than {RESERVE >> 20} MiB are left on the disk'
                message = self._queue.popleft()
                try:
                    if not self.failure:
                        self._writer.write(*message)
                        continue
                except (OSError, WriterError) as error:
                    self.failure, self._broken = reason(error), True
                # The queue is emptied all the same, so that close() does not block.
                self.dropped += 1
