# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The fingertip's URDF for a prefix, and the fixed frames in it; without xacro and without ROS."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import NamedTuple

from mixtac_events.errors import MixtacError
from mixtac_node.share import share

MACRO = '{http://www.ros.org/wiki/xacro}macro'
PREFIX = '${prefix}'


class DescriptionError(MixtacError):
    """A URDF that cannot be read without xacro."""


class FixedFrame(NamedTuple):
    """A frame in another one.

    Attributes:
        parent: The other frame.
        child: The frame.
        xyz: Its origin in the other [m].
        quaternion: Its rotation, x, y, z, w.
    """

    parent: str
    child: str
    xyz: tuple[float, float, float]
    quaternion: tuple[float, float, float, float]


def urdf_file() -> Path:
    """Return the path of the installed macro."""
    return share('mixtac_description') / 'urdf' / 'fingertip.urdf.xacro'


def fingertip_urdf(prefix: str = '', path: Path | None = None) -> str:
    """Return the URDF of one fingertip, as `xacro mixtac.urdf.xacro prefix:=PREFIX` writes it.

    Args:
        prefix: Put before the name of each link and joint.
        path: File with the macro; by default the installed one.

    Raises:
        DescriptionError: The macro has other expressions than its prefix.
    """
    path = path or urdf_file()
    macro = ET.parse(path).getroot().find(MACRO)  # noqa: S314  (our own file)
    if macro is None:
        raise DescriptionError(f'{path} has no macro', remedy='restore it')
    robot = ET.Element('robot', name=f'{prefix}mixtac')
    robot.extend(list(macro))
    text = ET.tostring(robot, encoding='unicode').replace(PREFIX, prefix)
    if '${' in text or '<xacro' in text:
        raise DescriptionError(
            f'{path} uses more of xacro than the prefix', remedy='write numbers, or run xacro'
        )
    return text


def fixed_frames(urdf: str) -> list[FixedFrame]:
    """Return the fixed joints of a URDF as frames.

    Args:
        urdf: Its text.
    """
    found = []
    for joint in ET.fromstring(urdf).iter('joint'):  # noqa: S314  (our own text)
        names = [joint.find(kind) for kind in ('parent', 'child')]
        parent, child = ('' if each is None else each.get('link', '') for each in names)
        origin = joint.find('origin')
        pose = {} if origin is None else origin.attrib
        xyz = tuple(float(each) for each in pose.get('xyz', '0 0 0').split())
        rpy = tuple(float(each) for each in pose.get('rpy', '0 0 0').split())
        found.append(FixedFrame(parent, child, (xyz[0], xyz[1], xyz[2]), quaternion(*rpy)))
    return found


def quaternion(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """Return the quaternion x, y, z, w of URDF's angles about fixed axes [rad]."""
    (a, x), (b, y), (c, z) = (
        (math.cos(0.5 * angle), math.sin(0.5 * angle)) for angle in (roll, pitch, yaw)
    )
    return (
        x * b * c - a * y * z,
        a * y * c + x * b * z,
        a * b * z - x * y * c,
        a * b * c + x * y * z,
    )
