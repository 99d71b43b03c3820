# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Writing serialised messages to an MCAP bag from a thread of its own."""

from __future__ import annotations

import queue
import threading
from typing import TYPE_CHECKING

from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.errors import WriterError

from mixtac_recordings.bag import typestore
from mixtac_recordings.recording import BagError

if TYPE_CHECKING:
    from pathlib import Path

    from rosbags.interfaces import Connection


QUEUE_SIZE = 20_000


def offered_qos(*, reliable: bool, latched: bool) -> Qos:
    """Return the QoS profile to record for a topic, for `ros2 bag play`.

    Args:
        reliable: Reliability that its publisher offers.
        latched: True for transient local.
    """
    zero = QosTime(0, 0)
    return Qos(
        QosHistory.KEEP_LAST,
        1000,
        QosReliability.RELIABLE if reliable else QosReliability.BEST_EFFORT,
        QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE,
        zero,
        zero,
        QosLiveliness.AUTOMATIC,
        zero,
        avoid_ros_namespace_conventions=False,
    )


class BagWriter:
    """Takes messages without blocking and writes them in order.

    A message that finds the queue full is dropped and counted: a slow disk must not hold up the
    subscriptions.

    Args:
        path: Folder of the new bag; must not exist.

    Attributes:
        written: Messages written so far, by topic.
        dropped: Messages dropped because the disk was too slow, or has failed.

    Raises:
        BagError: The folder exists already or cannot be made.
    """

    def __init__(self, path: Path) -> None:
        self.written: dict[str, int] = {}
        self.dropped = 0
        self._failure: Exception | None = None
        self._types = typestore()
        try:
            self._writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
            self._writer.open()
        except (WriterError, OSError) as error:
            raise BagError(
                f'cannot record to {path}: {error}; choose a folder that is new'
            ) from error
        self._queue: queue.Queue[tuple[Connection, int, bytes] | None] = queue.Queue(QUEUE_SIZE)
        self._thread = threading.Thread(target=self._work, name='bag-writer')
        self._thread.start()

    def add_topic(self, topic: str, type_name: str, *, reliable: bool, latched: bool) -> Connection:
        """Announce a topic and return the handle to write it with.

        Args:
            topic: Absolute topic name.
            type_name: For example `sensor_msgs/msg/Image`.
            reliable: QoS the publisher offers, recorded for `ros2 bag play`.
            latched: True for transient local.
        """
        self.written[topic] = 0
        return self._writer.add_connection(
            topic,
            type_name,
            typestore=self._types,
            offered_qos_profiles=(offered_qos(reliable=reliable, latched=latched),),
        )

    def write(self, connection: Connection, received_ns: int, data: bytes) -> None:
        """Queue one serialised message, received at host time `received_ns`."""
        try:
            self._queue.put_nowait((connection, received_ns, data))
        except queue.Full:
            self.dropped += 1

    @property
    def failure(self) -> str:
        """What the disk failed with, empty while it works."""
        return ' '.join(str(self._failure).split()) if self._failure else ''

    def close(self) -> None:
        """Write what is queued and finish the bag.

        Raises:
            BagError: The disk was full or failed; what was written before is there.
        """
        self._queue.put(None)
        self._thread.join()
        try:
            self._writer.close()
        except OSError as error:
            self._failure = self._failure or error
        if self._failure is not None:
            raise BagError(
                f'the bag could not be written to its end ({self.failure}): free some space'
            ) from self._failure

    def _work(self) -> None:
        while (item := self._queue.get()) is not None:
            connection, received_ns, data = item
            if self._failure is not None:
                self.dropped += 1
                continue
            try:
                self._writer.write(connection, received_ns, data)
            except (OSError, WriterError) as error:
                # The thread goes on, so that nobody waits for it.
                self._failure = error
                continue
            self.written[connection.topic] += 1
