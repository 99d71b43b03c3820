# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Publishes the fixed frames of a fingertip on `/tf_static`, and its URDF on `robot_description`.

In any namespace but the default one, the namespace is the prefix of all frames: two sensors have
two sets. Where the fingertip is a part of a robot's own URDF, robot_state_publisher publishes the
same frames, and this node is not needed.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from functools import partial
from pathlib import Path

from geometry_msgs.msg import TransformStamped
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String

from mixtac_core.node.base_node import BaseNode, run
from mixtac_core.node.files import share
from mixtac_core.node.process import GraphError
from mixtac_core.node.topics import frame_prefix

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
MACRO = '{http://www.ros.org/wiki/xacro}macro'
PREFIX = '${prefix}'


class FramesNode(BaseNode, Node):  # type: ignore[misc]
    """Publishes once; whoever comes later gets it as well."""

    def __init__(self) -> None:
        super().__init__('frames')
        try:
            from tf2_msgs.msg import TFMessage
        except ModuleNotFoundError as error:
            raise GraphError(
                'tf2_msgs is not installed', remedy='install ROS 2: the wheels do not have it'
            ) from error
        macro = share('mixtac_bringup') / 'urdf' / 'fingertip.urdf.xacro'
        urdf = fingertip_urdf(macro, frame_prefix(self.get_namespace()))
        frames = fixed_frames(urdf)
        for frame in frames:
            frame.header.stamp = self.get_clock().now().to_msg()
        self._tf = self.create_publisher(TFMessage, '/tf_static', LATCHED)
        self._tf.publish(TFMessage(transforms=frames))
        self._description = self.create_publisher(String, 'robot_description', LATCHED)
        self._description.publish(String(data=urdf))


def fingertip_urdf(path: Path, prefix: str = '') -> str:
    """Return the URDF of one fingertip, as `xacro mixtac.urdf.xacro prefix:=PREFIX` writes it.

    Args:
        path: File with the macro, which uses no expression of xacro but the prefix.
        prefix: Put before the name of each link and joint.
    """
    robot = ET.Element('robot', name=f'{prefix}mixtac')
    robot.extend(ET.parse(path).getroot().findall(f'{MACRO}/*'))  # noqa: S314  (our own file)
    return ET.tostring(robot, encoding='unicode').replace(PREFIX, prefix)


def fixed_frames(urdf: str) -> list[TransformStamped]:
    """Return the fixed joints of a URDF as transforms without a stamp."""
    from scipy.spatial.transform import Rotation

    frames = []
    for joint in ET.fromstring(urdf).iter('joint'):  # noqa: S314  (our own text)
        parts = {part.tag: part.attrib for part in joint}
        frame = TransformStamped(child_frame_id=parts['child']['link'])
        frame.header.frame_id = parts['parent']['link']
        move, turn = frame.transform.translation, frame.transform.rotation
        move.x, move.y, move.z = map(float, parts['origin']['xyz'].split())
        # URDF turns about fixed axes.
        angles = list(map(float, parts['origin']['rpy'].split()))
        turn.x, turn.y, turn.z, turn.w = map(float, Rotation.from_euler('xyz', angles).as_quat())
        frames.append(frame)
    return frames


main = partial(run, FramesNode)
