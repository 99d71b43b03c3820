# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Writing MCAP bags with checksums, directly or from a background thread, and repairing bags."""

from __future__ import annotations

import contextlib
import os
import shutil
import struct
import tempfile
import threading
import zlib
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import IO

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
from rosbags.typesys import TypesysError, get_types_from_msg

from mixtac_core.node.files import new_folder
from mixtac_core.recordings.bag import BagFile, check_new, custom_data, typestore
from mixtac_core.recordings.recording import RecordingError

QUEUE_SIZE = 20_000
FLUSH_PERIOD_S = 0.02
"""Time between two turns of the writing thread: to wake it for each message costs more [s]."""
_CHECKSUM_AT = 1 + 8 + 3 * 8
"""Place of the checksum in a chunk record: after code, length, two times and a size."""


RESERVE = 1 << 26
"""Space kept free for the end of a live recording: index and metadata of about 80 hours [bytes]."""


class _ChecksummedMcap(McapWriter):
    """Adds the CRC-32 of each chunk, so that readers notice flipped bytes; survives a full disk.

    Attributes:
        full: Disk error after which no more messages are written.
    """

    def __init__(self, path: Path, compression: CompressionMode) -> None:
        super().__init__(path, compression)
        self.bio.flush()
        self.full: OSError | None = None
        self._whole = self.bio.tell()
        self._reserve: IO[bytes] | None = None

    def reserve(self, size: int) -> None:
        """Keep space free for the last chunk, the index and the metadata.

        The space is that of a file without a name: it is free again when the process is killed.
        """
        self._reserve = tempfile.TemporaryFile(dir=self.path.parent)  # noqa: SIM115
        os.posix_fallocate(self._reserve.fileno(), 0, size)

    def write(self, connection: Connection, timestamp: int, data: bytes | memoryview) -> None:
        if self.full is not None:
            raise self.full
        super().write(connection, timestamp, data)

    def close_chunk(self) -> None:
        pending, count = self.chunk, len(self.chunks)
        try:
            self._write_chunk()
        except OSError as error:
            if self._reserve is None:
                raise
            self.full = error
            self._release()
            self._forget_buffered()
            del self.chunks[count:]
            self.chunk = pending
            self._write_chunk()
        self._whole = self.bio.tell()

    def close(self, version: int, metadata: str) -> None:
        self._release()
        super().close(version, metadata)

    def abort(self) -> None:
        self._release()
        super().abort()

    def _release(self) -> None:
        if self._reserve is not None:
            self._reserve.close()
            self._reserve = None

    def _forget_buffered(self) -> None:
        """Cut the file behind its last whole chunk, without what could not be written."""
        with Path(os.devnull).open('wb') as nowhere:
            os.dup2(nowhere.fileno(), self.bio.fileno())
        self.bio.close()
        self.bio = self.path.open('r+b')  # type: ignore[assignment]
        self.bio.truncate(self._whole)
        self.bio.seek(self._whole)

    def _write_chunk(self) -> None:
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
        definition of a known type is that of this workspace where the other bag's cannot be read.

        Args:
            connection: The topic in the other bag.
        """
        definition, known = connection.msgdef.data, typestore()
        if connection.msgtype in known.fielddefs:
            if not _readable(connection):
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


def _readable(connection: Connection) -> bool:
    """Return whether the library reads the definition of a topic's type that is in its bag."""
    definition, kind = connection.msgdef, connection.msgtype
    # It does not read the IDL that comes with ROS.
    if definition.format is not MessageDefinitionFormat.MSG or not definition.data:
        return False
    try:
        return kind in get_types_from_msg(definition.data, kind)
    except (TypesysError, ValueError, KeyError, IndexError):
        return False


@dataclass(frozen=True)
class Repair:
    """Result of a repair.

    Attributes:
        counts: Messages of the new bag, by topic.
        damage: What is missing of the old one, empty for nothing.
    """

    counts: dict[str, int]
    damage: str


def repair(path: Path, out: Path) -> Repair:
    """Write what is whole of a bag as a new one.

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
    the subscriptions. When the disk is full, the bag is finished at once.

    Args:
        path: Folder of the new bag; must not exist.

    Attributes:
        written: Messages written so far, by topic.
        dropped: Messages dropped because the disk was too slow, or has failed.

    Raises:
        RecordingError: The folder or a clock fit of its name exists, or it cannot be made.
    """

    def __init__(self, path: Path) -> None:
        check_new(path)
        self.written: dict[str, int] = {}
        self.dropped = 0
        self._failure: Exception | None = None
        self._finished = False
        try:
            self._writer = McapBag(path)
            self._writer.open()
            storage = self._writer.storage
            assert isinstance(storage, _ChecksummedMcap)  # noqa: S101  (the only plugin)
            storage.reserve(RESERVE)
        except (WriterError, OSError) as error:
            if isinstance(error, OSError):
                # The folder is ours: an existing one is a WriterError.
                with contextlib.suppress(OSError):
                    self._writer.abort()
                shutil.rmtree(path, ignore_errors=True)
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

    @property
    def failure(self) -> str:
        """Error of the disk, empty while it works."""
        return ' '.join(str(self._failure).split()) if self._failure else ''

    def close(self) -> None:
        """Write what is queued and finish the bag; after a failure it is finished already.

        Raises:
            RecordingError: The bag could not be finished.
        """
        self._closing.set()
        self._thread.join()
        if not self._finished:
            raise RecordingError(
                f'the bag is incomplete: {self.failure}',
                remedy='free some space, and run `mixtac repair`',
            ) from self._failure

    def _work(self) -> None:
        closing = False
        while not closing:
            closing = self._closing.wait(FLUSH_PERIOD_S)
            failed = self._failure is not None
            self._flush()
            # A full disk is likely to become fuller: the bag is finished at the first failure.
            if not failed and (closing or self._failure is not None):
                self._finish()

    def _finish(self) -> None:
        try:
            self._writer.close()
            self._finished = True
        except OSError as error:
            self._failure = self._failure or error

    def _flush(self) -> None:
        while self._queue:
            connection, received_ns, data = self._queue.popleft()
            if self._failure is not None:
                self.dropped += 1
                continue
            try:
                self._writer.write(connection, received_ns, data)
            except (OSError, WriterError) as error:
                # The thread keeps emptying the queue, so that close() does not block.
                self._failure = error
                self.dropped += 1
                continue
            self.written[connection.topic] += 1
