# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The message types that the driver reads from bags, without ROS."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from mixtac_driver.errors import RecordingError

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

EVENT_PACKET = 'event_camera_msgs/msg/EventPacket'
IMAGE = 'sensor_msgs/msg/Image'
IMU = 'sensor_msgs/msg/Imu'
CAMERA_INFO = 'sensor_msgs/msg/CameraInfo'
FRAME_EXPOSURE = 'mixtac_msgs/msg/FrameExposure'
EXTERNAL_EDGE = 'mixtac_msgs/msg/ExternalEdge'


def typestore() -> Typestore:
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
