# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Sends approaches to a trajectory controller through its FollowJointTrajectory action."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mixtac_slip_control.arm.trajectory import TrajectoryMessage
from mixtac_slip_control.errors import BackendError

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.node import Node
    from rclpy.task import Future

    from mixtac_slip_control.arm.trajectory import PlannedTrajectory


class ApproachClient:
    """Client of the action on behalf of a node that is being spun.

    Args:
        node: Node to speak for.
        action: Name of the action, for example '/fr3_arm_controller/follow_joint_trajectory'.

    Raises:
        BackendError: `control_msgs`, which defines the action, is not installed.
    """

    def __init__(self, node: Node, action: str) -> None:
        try:
            from control_msgs.action import FollowJointTrajectory
        except ImportError as error:
            raise BackendError(
                f'an approach needs control_msgs ({error}): sudo apt-get install '
                'ros-$ROS_DISTRO-control-msgs'
            ) from error
        from rclpy.action import ActionClient
        from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

        self._action = action
        self._type = FollowJointTrajectory
        self._client = ActionClient(node, FollowJointTrajectory, action)
        self._filler = TrajectoryMessage(JointTrajectory, JointTrajectoryPoint)

    def go(self, trajectory: PlannedTrajectory, done: Callable[[str | None], None]) -> None:
        """Send a trajectory; it starts when the controller takes it up.

        Args:
            trajectory: From `approach_trajectory`.
            done: Called with None when the arm has arrived, or with what went wrong.

        Raises:
            BackendError: No controller offers the action.
        """
        if not self._client.server_is_ready():
            raise BackendError(
                f'no controller offers {self._action}: start joint_trajectory_controller'
            )
        goal = self._type.Goal()
        goal.trajectory = self._filler.fill(trajectory, stamped=False)

        def on_result(future: Future) -> None:
            result = future.result().result
            failed = result.error_code != self._type.Result.SUCCESSFUL
            done(f'{result.error_string} (code {result.error_code})' if failed else None)

        def on_answer(future: Future) -> None:
            handle = future.result()
            if handle.accepted:
                handle.get_result_async().add_done_callback(on_result)
            else:
                done('the controller rejected the approach')

        self._client.send_goal_async(goal).add_done_callback(on_answer)
