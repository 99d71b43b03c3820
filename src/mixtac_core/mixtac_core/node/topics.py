# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Topics of the sensor graph: name, message type and QoS of each.

`docs/reference.md` describes the content and the clock of each topic. This module also reads and
writes force messages and stamps.
"""

from __future__ import annotations

import functools
import importlib
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

if TYPE_CHECKING:
    from builtin_interfaces.msg import Time
    from geometry_msgs.msg import WrenchStamped

DEFAULT_NAMESPACE = 'mixtac'
"""Namespace of all nodes unless the user gives another one (`__ns`)."""


@functools.cache
def message_class(type_name: str) -> Any:  # noqa: ANN401
    """Return the class of, for example, `sensor_msgs/msg/Image`."""
    package, kind, name = type_name.split('/')
    return getattr(importlib.import_module(f'{package}.{kind}'), name)


@dataclass(frozen=True, slots=True)
class Topic:
    """One topic.

    Attributes:
        name: Relative to the namespace, or absolute.
        type_name: For example `sensor_msgs/msg/Image`.
        reliable: Whether our subscriptions ask for lost messages again; publishers always offer
            to send them again.
        depth: Queue depth its publisher offers.
        latched: True for transient local.
    """

    name: str
    type_name: str
    reliable: bool = False
    depth: int = 10
    latched: bool = False

    def resolved(self, namespace: str) -> str:
        """Return the absolute name."""
        return absolute(self.name, namespace)


def absolute(name: str, namespace: str) -> str:
    """Return the absolute name of a topic, service or node.

    Args:
        name: Its name; an absolute one stays as it is.
        namespace: Its namespace, with or without a leading slash.
    """
    space = namespace.strip('/')
    return name if name.startswith('/') else f'/{space}/{name}' if space else f'/{name}'


CAMERA_FRAME = 'camera'
"""Default frame of events and images."""
IMU_FRAME = 'imu'
"""Default frame of inertial samples."""
REFERENCE_FRAME = 'ft_sensor'
"""Default frame of the reference force sensor."""
CONTACT_FRAME = 'mixtac_contact'
"""Default frame of forces and contacts: x to the right and y up in the image, z into the gel."""


def frame_prefix(namespace: str) -> str:
    """Return the prefix of the frame names of a sensor: nothing in the default one."""
    name = namespace.strip('/').replace('/', '_')
    return '' if name in {'', DEFAULT_NAMESPACE} else f'{name}_'


def frame_id(name: str, namespace: str) -> str:
    """Return a frame's name for the sensor of a namespace; names of the user's stay as they are."""
    own = name in (CAMERA_FRAME, IMU_FRAME, CONTACT_FRAME)
    return frame_prefix(namespace) + name if own else name


REFERENCE = '/ft_sensor/wrench'
"""Default topic of the reference force sensor."""
EVENTS = Topic('events', 'event_camera_msgs/msg/EventPacket', depth=1000)
IMAGE_RAW = Topic('image_raw', 'sensor_msgs/msg/Image')
CAMERA_INFO = Topic('camera_info', 'sensor_msgs/msg/CameraInfo')
IMAGE_COMPRESSED = Topic('image_raw/compressed', 'sensor_msgs/msg/CompressedImage')
EVENTS_RECT = Topic('events_rect', 'event_camera_msgs/msg/EventPacket', depth=1000)
IMAGE_EXPOSURE = Topic('image_exposure', 'mixtac_msgs/msg/FrameExposure')
IMU = Topic('imu/data_raw', 'sensor_msgs/msg/Imu')
TEMPERATURE = Topic('temperature', 'sensor_msgs/msg/Temperature')
EXTERNAL_EDGES = Topic('external_edges', 'mixtac_msgs/msg/ExternalEdge', reliable=True, depth=1000)
CAMERA_CLOCK = Topic(
    'camera_clock', 'sensor_msgs/msg/TimeReference', reliable=True, depth=1, latched=True
)
FORCE = Topic('force', 'geometry_msgs/msg/WrenchStamped', depth=100)
FORCE_QUALITY = Topic('force_quality', 'mixtac_msgs/msg/ForceQuality', depth=100)
CONTACT = Topic('contact', 'mixtac_msgs/msg/Contact', depth=100)
CONTACT_POINT = Topic('contact_point', 'geometry_msgs/msg/PointStamped', depth=100)
DISPLACEMENT = Topic('displacement', 'sensor_msgs/msg/Image')
DISPLACEMENT_POINTS = Topic('displacement/points', 'sensor_msgs/msg/PointCloud2')
REFERENCE_WRENCH = Topic(REFERENCE, 'geometry_msgs/msg/WrenchStamped', depth=100)
TRUTH_WRENCH = Topic('truth/wrench', 'geometry_msgs/msg/WrenchStamped', depth=100)
DIAGNOSTICS = Topic('/diagnostics', 'diagnostic_msgs/msg/DiagnosticArray', reliable=True)
CLOCK_FIT = Topic('clock_fit', 'mixtac_msgs/msg/ClockFit', reliable=True, depth=1, latched=True)
ALIGNMENT_REFERENCE = Topic('reference/wrench', 'geometry_msgs/msg/WrenchStamped', depth=100)
FORCE_ERROR_MAE = Topic('force_error/mae', 'std_msgs/msg/Float64', depth=100)
FORCE_ERROR_RMSE = Topic('force_error/rmse', 'std_msgs/msg/Float64', depth=100)
SLIP = Topic('slip', 'mixtac_msgs/msg/SlipState', depth=100)
GRIP = Topic('grip', 'std_msgs/msg/Float64MultiArray')

TOPICS = tuple(each for each in list(globals().values()) if isinstance(each, Topic))
"""What the nodes of a sensor publish and subscribe to: all of the above."""

# Only in bags of simulated trials, and of the simulated grasp: no node of the sensor uses them.
TRUTH_CONTACT = Topic('truth/contact', 'geometry_msgs/msg/PointStamped', depth=100)
TRUTH_CLOCK_FIT = Topic(
    'truth/clock_fit', 'mixtac_msgs/msg/ClockFit', reliable=True, depth=1, latched=True
)
TRUTH_OBJECT = Topic('truth/object', 'geometry_msgs/msg/PointStamped', depth=100)

ForceMessage: TypeAlias = 'WrenchStamped'
"""Message of `FORCE` and of the reference force sensors."""


def normal_force(message: ForceMessage) -> float:
    """Return the normal force [N] of a message of `FORCE` or of a reference force sensor."""
    return float(message.wrench.force.z)


def sideways_force(message: ForceMessage) -> tuple[float, float]:
    """Return the force along x and y [N] of such a message."""
    force = message.wrench.force
    return float(force.x), float(force.y)


def us_to_stamp(t_us: int) -> Time:
    """Return a time [us since the epoch of its clock] as a ROS stamp."""
    return ns_to_stamp(1000 * int(t_us))


def stamp_to_us(stamp: Time) -> int:
    """Return a ROS stamp as whole microseconds (rounded down) of its clock."""
    return stamp_to_ns(stamp) // 1000


def ns_to_stamp(t_ns: int) -> Time:
    """Return a time [ns since the epoch of its clock] as a ROS stamp."""
    from builtin_interfaces.msg import Time

    seconds, nanoseconds = divmod(int(t_ns), 1_000_000_000)
    return Time(sec=seconds, nanosec=nanoseconds)


def stamp_to_ns(stamp: Time) -> int:
    """Return a ROS stamp in nanoseconds of its clock."""
    return int(stamp.sec * 1_000_000_000 + stamp.nanosec)


_STAMP = struct.Struct('<iI')
_NUMBERS = struct.Struct('<6d')
_LITTLE_ENDIAN = b'\0\1\0\0'
"""Representation of the data that follow (CDR)."""


class WrenchWriter:
    """Writes wrenches as serialised messages, which costs less than to fill and convert one.

    Args:
        frame_id: Frame of the wrenches.
    """

    def __init__(self, frame_id: str) -> None:
        name = frame_id.encode() + b'\0'
        header = _STAMP.pack(0, 0) + struct.pack('<I', len(name)) + name
        # Numbers of eight bytes lie at multiples of eight, counted from the stamp.
        header += bytes(-len(header) % 8)
        self._bytes = bytearray(_LITTLE_ENDIAN + header + _NUMBERS.pack(*[0.0] * 6))

    def serialised(self, stamp_ns: int, wrench: Sequence[float]) -> bytes:
        """Return a message.

        Args:
            stamp_ns: Its stamp [ns].
            wrench: Force along x, y and z [N], torque about them [N m].
        """
        _STAMP.pack_into(self._bytes, len(_LITTLE_ENDIAN), *divmod(stamp_ns, 1_000_000_000))
        _NUMBERS.pack_into(self._bytes, len(self._bytes) - _NUMBERS.size, *wrench)
        return bytes(self._bytes)
