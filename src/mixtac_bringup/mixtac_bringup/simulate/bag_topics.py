# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The topics of a simulated bag: those of the live graph and the truth."""

from __future__ import annotations

from typing import Final

from mixtac_bringup.topics import REFERENCE, Topic, topic
from mixtac_driver.driver_parameters import DriverParameters
from mixtac_sim.virtual_sensor_parameters import VirtualSensorParameters

NAMESPACE: Final = 'mixtac'
TRUTH_CONTACT: Final = 'truth/contact'
TRUTH_CLOCK: Final = 'truth/clock_fit'
TRUTH_WRENCH: Final = 'truth/wrench'

BAG_TOPICS: Final = (
    *map(
        topic,
        (
            *('events', 'image_raw', 'camera_info', 'image_exposure', 'imu', 'temperature'),
            *('camera_clock', REFERENCE, TRUTH_WRENCH),
        ),
    ),
    Topic(
        TRUTH_CONTACT,
        'geometry_msgs/msg/PointStamped',
        reliable=False,
        depth=100,
        description='Where the indenter meets the skin (x, y from the optical axis) and how deep '
        'the dent is (z) [m], 1 kHz, on the host clock.',
    ),
    Topic(
        TRUTH_CLOCK,
        'mixtac_msgs/msg/ClockFit',
        reliable=True,
        depth=1,
        latched=True,
        description='True map from the camera clock to the reference clock.',
    ),
)
"""Topics in the order in which they are announced in the bag."""


def frame_ids() -> dict[str, str]:
    """Return the frames that the nodes publish in by default."""
    driver, sensor = DriverParameters(), VirtualSensorParameters()
    return {
        'camera': driver.camera_frame_id,
        'imu': driver.imu_frame_id,
        'contact': sensor.truth_frame_id,
        'reference': sensor.reference_frame_id,
    }
