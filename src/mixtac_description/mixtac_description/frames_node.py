# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Publishes the fixed frames of a fingertip on `/tf_static`, and its URDF on `robot_description`.

In any namespace but the default one, the namespace is the prefix of all frames: two sensors have
two sets. Where the fingertip is a part of a robot's own URDF, robot_state_publisher publishes the
same frames, and this node is not needed.
"""

from __future__ import annotations

from functools import partial

from geometry_msgs.msg import TransformStamped
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String

from mixtac_description.fingertip import (
    DescriptionError,
    FixedFrame,
    fingertip_urdf,
    fixed_frames,
)
from mixtac_node.base_node import BaseNode, run
from mixtac_node.topics import frame_prefix

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class FramesNode(BaseNode, Node):  # type: ignore[misc]
    """Publishes once; whoever comes later gets it as well."""

    def __init__(self) -> None:
        super().__init__('frames')
        try:
            from tf2_msgs.msg import TFMessage
        except ModuleNotFoundError as error:
            raise DescriptionError(
                'tf2_msgs is not installed', remedy='install ROS 2: the wheels do not have it'
            ) from error
        urdf = fingertip_urdf(frame_prefix(self.get_namespace()))
        now = self.get_clock().now().to_msg()
        self._tf = self.create_publisher(TFMessage, '/tf_static', LATCHED)
        self._tf.publish(TFMessage(transforms=[transform(f, now) for f in fixed_frames(urdf)]))
        self._description = self.create_publisher(String, 'robot_description', LATCHED)
        self._description.publish(String(data=urdf))


def transform(frame: FixedFrame, stamp: object) -> TransformStamped:
    """Return a frame as a message."""
    message = TransformStamped(child_frame_id=frame.child)
    message.header.frame_id, message.header.stamp = frame.parent, stamp
    move, turn = message.transform.translation, message.transform.rotation
    move.x, move.y, move.z = frame.xyz
    turn.x, turn.y, turn.z, turn.w = frame.quaternion
    return message


main = partial(run, FramesNode)
