# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Which profile of Fast DDS the nodes use, for launch files; `tools/env.sh` decides alike."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ament_index_python.packages import get_package_share_directory

if TYPE_CHECKING:
    from collections.abc import Mapping

VARIABLES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')
"""Fast DDS 2 (ROS 2 Jazzy) reads the first, Fast DDS 3 the second."""
_ON_THIS_MACHINE = {'LOCALHOST', 'OFF'}


def profile_environment(environment: Mapping[str, str]) -> dict[str, str]:
    """Return the variables to add, none where the user has a profile already.

    Args:
        environment: That of the nodes; `ROS_AUTOMATIC_DISCOVERY_RANGE` decides between loopback
            and all interfaces.
    """
    if any(environment.get(name) for name in VARIABLES):
        return {}
    local = environment.get('ROS_AUTOMATIC_DISCOVERY_RANGE', '') in _ON_THIS_MACHINE
    name = 'local.xml' if local else 'network.xml'
    path = Path(get_package_share_directory('mixtac_bringup')) / 'config' / 'fastdds' / name
    return dict.fromkeys(VARIABLES, str(path))
