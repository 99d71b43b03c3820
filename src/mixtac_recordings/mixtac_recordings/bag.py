# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Reading rosbag2 bags (a folder, .mcap or .db3) and the message types in them, without rclpy."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from mixtac_recordings.recording import BagError, DamagedRecordingError, RecordingError

if TYPE_CHECKING:
    from collections.abc import Generator, Iterator, Sequence
    from types import TracebackType

    from numpy.typing import NDArray
    from rosbags.typesys.store import Typestore


EVENT_PACKET = 'event_camera_msgs/msg/EventPacket'
IMAGE = 'sensor_msgs/msg/Image'
IMU = 'sensor_msgs/msg/Imu'
CAMERA_INFO = 'sensor_msgs/msg/CameraInfo'
FRAME_EXPOSURE = 'mixtac_msgs/msg/FrameExposure'
EXTERNAL_EDGE = 'mixtac_msgs/msg/ExternalEdge'


def camera_typestore() -> Typestore:
    """Return Jazzy's standard types plus those of cameras, from their installed definitions.

    Raises:
        RecordingError: The packages that define them are not installed.
    """
    store = get_typestore(Stores.ROS2_JAZZY)
    for name in (EVENT_PACKET, FRAME_EXPOSURE, EXTERNAL_EDGE):
        package, _, message = name.split('/')
        try:
            share = Path(get_package_share_directory(package))
        except PackageNotFoundError as error:
            raise RecordingError(
                f'bags cannot be read without {package}: source the workspace or install it'
            ) from error
        store.register(get_types_from_msg((share / 'msg' / f'{message}.msg').read_text(), name))
    return store


OWN_TYPES = (
    'event_camera_msgs/msg/EventPacket',
    'mixtac_msgs/msg/ClockFit',
    'mixtac_msgs/msg/ExternalEdge',
    'mixtac_msgs/msg/ForceQuality',
    'mixtac_msgs/msg/FrameExposure',
    'mixtac_msgs/msg/SlipState',
)


def typestore() -> Typestore:
    """Return Jazzy's standard types plus those of the workspace, read from its own definitions."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for name in OWN_TYPES:
        package, _, message = name.split('/')
        try:
            share = Path(get_package_share_directory(package))
        except PackageNotFoundError:
            continue
        store.register(get_types_from_msg((share / 'msg' / f'{message}.msg').read_text(), name))
    return store


SUFFIXES = ('.mcap', '.db3')


class SeekableBag:
    """A bag, open for reading.

    Args:
        path: Folder or file.

    Attributes:
        duration_ns: From the first to the last message [ns, host clock of the recorder].
        start_ns: When the first message was received [ns, host clock of the recorder].

    Raises:
        RecordingError: It is none, or damaged.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._types = camera_typestore()
        if path.is_dir() and not (path / 'metadata.yaml').exists():
            raise RecordingError(
                f'{path} holds no metadata.yaml: give the folder of a bag, name the .mcap or .db3 '
                'file in it, or run `ros2 bag reindex` on it'
            )
        try:
            self._reader = Reader(path)
            self._reader.open()
        except Exception as error:  # the format's parsers raise whatever damage leads them to
            raise self._damaged(error) from error
        self.duration_ns = self._reader.duration
        self.start_ns = self._reader.start_time

    def close(self) -> None:
        """Give the files back."""
        if self._reader.is_open:
            self._reader.close()

    def topics(self, kind: str) -> list[str]:
        """Return the topics of a message type that hold any messages."""
        found = {c.topic for c in self._reader.connections if c.msgtype == kind and c.msgcount}
        return sorted(found)

    def messages(
        self, topics: Sequence[str], start_ns: int | None = None, stop_ns: int | None = None
    ) -> Generator[tuple[str, int, Any], None, None]:
        """Yield (topic, time received [ns], message) in the order recorded.

        Args:
            topics: Topics to read.
            start_ns: Begin with what was received at this time; None for the first.
            stop_ns: End before what was received at this time; None for the last.

        Raises:
            DamagedRecordingError: As said.
        """
        chosen = [c for c in self._reader.connections if c.topic in topics]
        if not chosen:
            return
        messages = self._reader.messages(chosen, start_ns, stop_ns)
        while True:
            try:
                connection, received_ns, data = next(messages)
                message = self._types.deserialize_cdr(data, connection.msgtype)
            except StopIteration:
                return
            except Exception as error:  # as above
                raise self._damaged(error) from error
            yield connection.topic, received_ns, message

    def _damaged(self, error: Exception) -> DamagedRecordingError:
        text = ' '.join(str(error).split()) or type(error).__name__
        return DamagedRecordingError(
            f'{self._path} is not a whole bag ({text}): it was cut off while recording or copying; '
            'record it again, or repair it with `ros2 bag reindex`'
        )


_NS = 1_000_000_000


class BagFile:
    """One rosbag2 recording (MCAP or sqlite3), opened for reading.

    Args:
        path: Folder of the bag.

    Attributes:
        duration_s: From the first to the last message [s].
        counts: Messages by topic.
        types: Type name by topic.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        if not path.exists():
            raise BagError(f'no bag at {path}: give the folder that holds metadata.yaml')
        self._types = typestore()
        try:
            self._reader = Reader(path)
            self._reader.open()
        except Exception as error:  # the format's parsers raise whatever damage leads them to
            raise self._damaged(error) from error
        self.duration_s = self._reader.duration / 1e9
        self.counts = {c.topic: c.msgcount for c in self._reader.connections}
        self.types = {c.topic: c.msgtype for c in self._reader.connections}

    def __enter__(self) -> BagFile:
        """Return the open bag."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the bag."""
        self._reader.close()

    def messages(self, topic: str) -> Iterator[tuple[int, Any]]:
        """Yield (host time received [ns], message) of a topic in recording order.

        Raises:
            BagError: The topic was not recorded, or the data are damaged.
        """
        for _, received_ns, message in self.messages_of(topic):
            yield received_ns, message

    def messages_of(
        self, *topics: str, raw: tuple[str, ...] = ()
    ) -> Iterator[tuple[str, int, Any]]:
        """Yield (topic, host time received [ns], message) of several topics in one pass.

        Args:
            topics: Absolute topic names.
            raw: Those of them whose messages stay serialised: ``bytes`` in CDR.

        Raises:
            BagError: A topic was not recorded, or the data are damaged.
        """
        chosen = [c for c in self._reader.connections if c.topic in topics]
        missing = set(topics) - {c.topic for c in chosen}
        if missing:
            raise BagError(
                f'{self._path} has no topic {min(missing)}; it has {", ".join(self.counts)}'
            )
        try:
            for connection, received_ns, data in self._reader.messages(chosen):
                if connection.topic in raw:
                    yield connection.topic, received_ns, data
                    continue
                message = self._types.deserialize_cdr(data, connection.msgtype)
                yield connection.topic, received_ns, message
        except (GeneratorExit, BagError):
            raise
        except Exception as error:  # see above
            raise self._damaged(error) from error

    def wrenches(self, topic: str) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return the stamps [ns, the topic's own clock] and normal forces [N] of a topic."""
        stamps, forces = [], []
        for _, message in self.messages(topic):
            stamps.append(message.header.stamp.sec * _NS + message.header.stamp.nanosec)
            forces.append(message.wrench.force.z)
        return np.array(stamps, np.int64), np.array(forces, np.float64)

    def _damaged(self, error: Exception) -> BagError:
        text = ' '.join(str(error).split()) or type(error).__name__
        return BagError(
            f'{self._path} is not a whole bag ({text}): it was cut off while recording or copying; '
            'record it again, or repair it with `ros2 bag reindex`'
        )
