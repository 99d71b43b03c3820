# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The topics of the sensor graph: names, types, QoS. The contract that tests and docs hold to."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Topic:
    """One topic.

    Attributes:
        name: Relative to the namespace, or absolute.
        type_name: For example `sensor_msgs/msg/Image`.
        reliable: Reliability its publisher offers.
        depth: Queue depth its publisher offers.
        latched: True for transient local.
        description: What it carries, on which clock.
    """

    name: str
    type_name: str
    reliable: bool
    depth: int
    description: str
    latched: bool = False

    def resolved(self, namespace: str) -> str:
        """Return the absolute name."""
        return self.name if self.name.startswith('/') else f'/{namespace.strip("/")}/{self.name}'


REFERENCE = '/ft_sensor/wrench'

TOPICS = (
    Topic(
        'events',
        'event_camera_msgs/msg/EventPacket',
        reliable=False,
        depth=1000,
        description='Events, encoding `libcaer_cmp`, a packet every 1 ms or less; `time_base` on '
        'the camera clock [ns], `header.stamp` the arrival on the host.',
    ),
    Topic(
        'image_raw',
        'sensor_msgs/msg/Image',
        reliable=False,
        depth=10,
        description='APS frame, `mono16`, 10 bit left-aligned; stamp is mid-exposure on the camera '
        'clock.',
    ),
    Topic(
        'camera_info',
        'sensor_msgs/msg/CameraInfo',
        reliable=False,
        depth=10,
        description='With the stamp of its frame.',
    ),
    Topic(
        'imu',
        'sensor_msgs/msg/Imu',
        reliable=False,
        depth=10,
        description='Acceleration [m/s^2] and angular velocity [rad/s]; stamp on the camera clock.',
    ),
    Topic(
        'camera_clock',
        'sensor_msgs/msg/TimeReference',
        reliable=True,
        depth=1,
        latched=True,
        description='Once a second: a host time in `header.stamp` and the camera clock at that '
        'time in `time_ref`.',
    ),
    Topic(
        'force',
        'geometry_msgs/msg/WrenchStamped',
        reliable=False,
        depth=100,
        description='Estimated force at 500 Hz, `force.z` the normal force [N]; stamp is the end '
        'of the event window on the camera clock, frame `mixtac_contact`.',
    ),
    Topic(
        REFERENCE,
        'geometry_msgs/msg/WrenchStamped',
        reliable=False,
        depth=100,
        description='Reference force sensor, 800 Hz, on its own clock (the virtual one, or yours).',
    ),
    Topic(
        'truth/wrench',
        'geometry_msgs/msg/WrenchStamped',
        reliable=False,
        depth=100,
        description='Virtual sensor only: the simulated force itself, 1 kHz, on the host clock.',
    ),
    Topic(
        '/diagnostics',
        'diagnostic_msgs/msg/DiagnosticArray',
        reliable=True,
        depth=10,
        description='State of every node once a second.',
    ),
    Topic(
        'clock_fit',
        'mixtac_msgs/msg/ClockFit',
        reliable=True,
        depth=1,
        latched=True,
        description='Map from the camera clock to the reference clock (alignment node).',
    ),
    Topic(
        'slip',
        'mixtac_msgs/msg/SlipState',
        reliable=False,
        depth=100,
        description='Slip detection per 1 ms window (slip control node).',
    ),
)


def topic(name: str) -> Topic:
    """Return a topic by its relative name."""
    return next(each for each in TOPICS if each.name == name)
