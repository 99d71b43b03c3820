# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Topics and services of the sensor graph: name, message type and QoS of each.

Beside them, reading and writing the message of the forces.
"""

from __future__ import annotations

import functools
import importlib
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

if TYPE_CHECKING:
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
        description: What it carries, on which clock.
        reliable: Whether our subscriptions ask for lost messages again; publishers always offer
            to send them again.
        depth: Queue depth its publisher offers.
        latched: True for transient local.
        condition: Parameter that must be set for it to be published, empty for none.
    """

    name: str
    type_name: str
    description: str
    reliable: bool = False
    depth: int = 10
    latched: bool = False
    condition: str = ''

    @property
    def has_header(self) -> bool:
        """Whether its messages begin with a `std_msgs/Header`."""
        return self.type_name not in {
            'std_msgs/msg/Float64',
            'std_msgs/msg/Float64MultiArray',
            'std_msgs/msg/Bool',
        }

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
    """Return what the names of the frames of a sensor begin with: nothing in the default one."""
    name = namespace.strip('/').replace('/', '_')
    return '' if name in {'', DEFAULT_NAMESPACE} else f'{name}_'


def frame_id(name: str, namespace: str) -> str:
    """Return a frame's name for the sensor of a namespace; names of the user's stay as they are."""
    own = name in (CAMERA_FRAME, IMU_FRAME, CONTACT_FRAME)
    return frame_prefix(namespace) + name if own else name


REFERENCE = '/ft_sensor/wrench'
EVENTS = Topic(
    'events',
    'event_camera_msgs/msg/EventPacket',
    depth=1000,
    description='Events, encoding `libcaer_cmp`, a packet every 1 ms or less; `time_base` on '
    'the camera clock [ns], `header.stamp` the arrival on the host.',
)
IMAGE_RAW = Topic(
    'image_raw',
    'sensor_msgs/msg/Image',
    description='APS frame, `mono16`, 10 bit left-aligned; stamp is mid-exposure on the camera '
    'clock.',
)
CAMERA_INFO = Topic(
    'camera_info',
    'sensor_msgs/msg/CameraInfo',
    description='Calibration of the lens, with the stamp of its frame.',
)
IMAGE_COMPRESSED = Topic(
    'image_raw/compressed',
    'sensor_msgs/msg/CompressedImage',
    condition='image_transport',
    description='With `image_transport: compressed`: frames as `image_transport republish` sends '
    'them.',
)
EVENTS_RECT = Topic(
    'events_rect',
    'event_camera_msgs/msg/EventPacket',
    depth=1000,
    condition='undistort_events',
    description='With `undistort_events`: events at the pixels of a rectified image; others are '
    'dropped.',
)
IMAGE_EXPOSURE = Topic(
    'image_exposure',
    'mixtac_msgs/msg/FrameExposure',
    description='With the header of its frame: start and end of its exposure and of its '
    'read-out on the camera clock.',
)
IMU = Topic(
    'imu/data_raw',
    'sensor_msgs/msg/Imu',
    description='Acceleration [m/s^2] and angular velocity [rad/s], no orientation; stamp on the '
    'camera clock.',
)
TEMPERATURE = Topic(
    'temperature',
    'sensor_msgs/msg/Temperature',
    description='Temperature of the inertial unit in the camera, 10 Hz; stamp on the camera clock.',
)
EXTERNAL_EDGES = Topic(
    'external_edges',
    'mixtac_msgs/msg/ExternalEdge',
    reliable=True,
    depth=1000,
    description='Edges and pulses at the synchronisation connector; stamp on the camera clock.',
)
CAMERA_CLOCK = Topic(
    'camera_clock',
    'sensor_msgs/msg/TimeReference',
    reliable=True,
    depth=1,
    latched=True,
    description='Once a second: a host time in `header.stamp` and the camera clock at that '
    'time in `time_ref`.',
)
FORCE = Topic(
    'force',
    'geometry_msgs/msg/WrenchStamped',
    depth=100,
    description='Estimated force on the skin at 500 Hz: `force.z` the normal force, `force.x` and '
    '`force.y` sideways (right and up in the image) [N], `torque.z` [Nm]; 0 where `force_quality` '
    'says unknown. Stamp is the end of the event window on the camera clock, frame '
    '`mixtac_contact`.',
)
FORCE_QUALITY = Topic(
    'force_quality',
    'mixtac_msgs/msg/ForceQuality',
    depth=100,
    description='For each window, with the stamp of its `force`: which axes are known and their '
    'standard deviations, the age of the latest frame, whether all events arrived, and whether the '
    'force is valid or why not. Also while invalid forces are withheld.',
)
CONTACT = Topic(
    'contact',
    'mixtac_msgs/msg/Contact',
    depth=100,
    condition='contact',
    description='Whether and where something touches the sensor, the area and its axes, in the '
    'contact frame, at 500 Hz; stamp as of `force`.',
)
CONTACT_POINT = Topic(
    'contact_point',
    'geometry_msgs/msg/PointStamped',
    depth=100,
    condition='contact',
    description='Place of the contact [m] while it is known, with the stamp of its `contact`.',
)
DISPLACEMENT = Topic(
    'displacement',
    'sensor_msgs/msg/Image',
    condition='displacement',
    description='With `displacement`: that of the beads since the reference, along x and y of the '
    'contact frame [m], `32FC2`, a value every 8 px; stamp on the camera clock.',
)
DISPLACEMENT_POINTS = Topic(
    'displacement/points',
    'sensor_msgs/msg/PointCloud2',
    condition='displacement',
    description='With `displacement`: the same as points with `x`, `y`, `z`, `dx`, `dy` [m] and '
    '`confidence` (0 to 1), in the contact frame.',
)
ForceMessage: TypeAlias = 'WrenchStamped'
"""Message of `FORCE` and of the reference force sensors."""


def normal_force(message: ForceMessage) -> float:
    """Return the normal force [N] of a message of `FORCE` or of a reference force sensor."""
    return float(message.wrench.force.z)


def sideways_force(message: ForceMessage) -> tuple[float, float]:
    """Return the force along x and y [N] of such a message."""
    force = message.wrench.force
    return float(force.x), float(force.y)


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


REFERENCE_WRENCH = Topic(
    REFERENCE,
    'geometry_msgs/msg/WrenchStamped',
    depth=100,
    description='Reference force sensor (real or virtual), 800 Hz, on its own clock.',
)
TRUTH_WRENCH = Topic(
    'truth/wrench',
    'geometry_msgs/msg/WrenchStamped',
    depth=100,
    description='Virtual sensor only: the simulated force itself, 1 kHz, on the host clock.',
)
DIAGNOSTICS = Topic(
    '/diagnostics',
    'diagnostic_msgs/msg/DiagnosticArray',
    reliable=True,
    description='State of every node once a second.',
)
CLOCK_FIT = Topic(
    'clock_fit',
    'mixtac_msgs/msg/ClockFit',
    reliable=True,
    depth=1,
    latched=True,
    description='Map from the camera clock to the reference clock (alignment node).',
)
ALIGNMENT_REFERENCE = Topic(
    'reference/wrench',
    'geometry_msgs/msg/WrenchStamped',
    depth=100,
    description='The reference force, stamps on the camera clock, once there is a fit '
    '(alignment node).',
)
FORCE_ERROR_MAE = Topic(
    'force_error/mae',
    'std_msgs/msg/Float64',
    depth=100,
    description='Running mean absolute error of `force` against the aligned reference [N] '
    '(force error node).',
)
FORCE_ERROR_RMSE = Topic(
    'force_error/rmse',
    'std_msgs/msg/Float64',
    depth=100,
    description='Running root mean square error of `force` against the aligned reference [N] '
    '(force error node).',
)
SLIP = Topic(
    'slip',
    'mixtac_msgs/msg/SlipState',
    depth=100,
    description='Slip detection per 1 ms window (slip control node).',
)
GRIP = Topic(
    'grip',
    'std_msgs/msg/Float64MultiArray',
    condition='gripper',
    description='With `gripper` of the slip control node: one number, the force that a gripper '
    'shall hold [N] or its closing speed [m/s], as the command of a `forward_command_controller`.',
)

TOPICS = tuple(each for each in list(globals().values()) if isinstance(each, Topic))
"""What the nodes of a sensor publish and subscribe to: all of the above."""

# Only in bags of simulated trials, and of the simulated grasp: no node of the sensor uses them.
TRUTH_CONTACT = Topic(
    'truth/contact',
    'geometry_msgs/msg/PointStamped',
    depth=100,
    description='Where the indenter first meets the skin (x, y in the contact frame) and depth of '
    'the dent (z) [m], 1 kHz, on the host clock.',
)
TRUTH_CLOCK_FIT = Topic(
    'truth/clock_fit',
    'mixtac_msgs/msg/ClockFit',
    reliable=True,
    depth=1,
    latched=True,
    description='True map from the camera clock to the reference clock.',
)
TRUTH_OBJECT = Topic(
    'truth/object',
    'geometry_msgs/msg/PointStamped',
    depth=100,
    description='Position of the simulated grasped object in the contact frame, y upwards [m].',
)


@dataclass(frozen=True, slots=True)
class Service:
    """One service.

    Attributes:
        name: Relative to the namespace.
        description: What it does.
        type_name: For example `std_srvs/srv/Trigger`.
    """

    name: str
    description: str
    type_name: str = 'std_srvs/srv/Trigger'


SERVICES = (
    Service(
        'driver/snapshot',
        'Takes one frame if `aps_enabled` is off, waits for the next one if it is on. The response '
        'holds its stamp.',
    ),
    Service(
        'driver/reset_timestamps', "Sets the camera's own clock to zero; published time continues."
    ),
    Service(
        'driver/set_camera_info',
        'Checks a calibration, writes it to `camerainfo_url` and uses it.',
        'sensor_msgs/srv/SetCameraInfo',
    ),
    Service(
        'driver/find_hot_pixels',
        'Counts events for `hot_pixels_duration` and masks hot pixels: the eight noisiest '
        'in the camera, the others in the driver. Keep the scene still.',
    ),
    Service(
        'virtual_sensor/play',
        'Virtual sensor only: plays the scenario that the parameters describe.',
    ),
    Service(
        'virtual_sensor/touch',
        'Virtual sensor only: presses, pulls, slides, turns, loads, drops, vibrates or releases an '
        'object on the skin.',
        'mixtac_msgs/srv/Touch',
    ),
    Service('fger/tare', 'Sets the zero of the force to the current value.'),
    Service('alignment/fit', 'Fits the clocks to the data received so far.'),
    Service(
        'slip_control/enable',
        'Enables or disables motion of the arm on slip.',
        'std_srvs/srv/SetBool',
    ),
    Service('slip_control/tare', 'Learns the background event rate again; keep the object still.'),
    Service('slip_control/reset', 'Clears a latched stop; refused while its cause persists.'),
)
