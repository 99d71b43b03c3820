# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The message types of a Mixtac recording, for tools that read bags without ROS."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

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
