# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A simulated FR3 behind an emulated joint_trajectory_controller, as a node."""

from __future__ import annotations

from functools import partial

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from mixtac_core.events.arrays import Floats
from mixtac_core.node.base_node import BaseNode, declare, run
from mixtac_core.node.diagnostics import OK, WARN, DiagnosticsPublisher, Status
from mixtac_core.node.topics import ns_to_stamp, stamp_to_ns
from mixtac_sim.arm import (
    JOINT_NAMES,
    READY,
    SIDEWAYS,
    JointTrajectoryController,
    LaggingArm,
    Trajectory,
    warm_up,
)
from mixtac_sim.parameters import VirtualArmParameters

BEFORE_S = 100.0
"""The controller's time at the start [s]: a stamp of zero would mean something else."""
MAX_CATCH_UP_S = 60.0
"""A longer gap is a clock that was set (simulated time has begun): the arm rests after it [s]."""
STATE_PERIOD_S = 4e-3
"""Period of the joint states [s]."""


class VirtualArmNode(BaseNode, Node):  # type: ignore[misc]
    """Accepts trajectories, follows them with a lag and publishes joint states.

    Cycles of the controller are computed when joint states are due; they lie on their own grid of
    host time, so that this makes no difference to the motion.
    """

    def __init__(self) -> None:
        super().__init__('virtual_arm')
        parameters = declare(self, VirtualArmParameters)
        self._diagnostics = DiagnosticsPublisher(self, 'virtual_arm', self._status)
        with self._diagnostics.compiling('the simulated controller'):
            warm_up()
        self._controller = JointTrajectoryController()
        self._arm = LaggingArm(READY, SIDEWAYS)
        self._controller.reset(READY, BEFORE_S)
        self._accepted = self._rejected = 0
        self._problem = ''
        # Seconds since 1970 would round a cycle of 1 ms by 0.02 %, which looks like a jerk.
        self._origin_ns = self.get_clock().now().nanoseconds
        self._states = self.create_publisher(JointState, parameters.joint_state_topic, 10)
        self.create_subscription(
            JointTrajectory, parameters.trajectory_topic, self._on_trajectory, 10
        )
        self.create_timer(STATE_PERIOD_S, self._publish)

    def _seconds(self, time_ns: int) -> float:
        """Return a time on the controller's scale [s]."""
        return float(BEFORE_S + 1e-9 * (time_ns - self._origin_ns))

    def _on_trajectory(self, message: JointTrajectory) -> None:
        now_s = self._follow(self.get_clock().now().nanoseconds)
        if tuple(message.joint_names) != JOINT_NAMES:
            reason: str | None = f'joints {message.joint_names} are not {list(JOINT_NAMES)}'
        else:
            stamp_ns = stamp_to_ns(message.header.stamp)
            start_s = self._seconds(stamp_ns) if stamp_ns else 0.0
            reason = self._controller.accept(_fields(message, start_s), now_s)
        if reason is None:
            self._accepted += 1
            return
        self._rejected += 1
        self._problem = reason
        self.get_logger().warning(f'trajectory rejected: {reason}', throttle_duration_sec=2.0)

    def _follow(self, now_ns: int) -> float:
        """Run the controller's cycles up to a time; return it on the controller's scale [s]."""
        controller = self._controller
        if abs(self._seconds(now_ns) - controller.next_cycle_s) > MAX_CATCH_UP_S:
            self._origin_ns = now_ns
            held = controller.sample(controller.next_cycle_s + MAX_CATCH_UP_S)[0]
            controller.reset(held, BEFORE_S)
        now_s = self._seconds(now_ns)
        for command in controller.cycles(now_s):
            self._arm.track(command)
        return now_s

    def _publish(self) -> None:
        now = self.get_clock().now()
        self._follow(now.nanoseconds)
        message = JointState()
        message.header.stamp = ns_to_stamp(now.nanoseconds)
        message.name = list(JOINT_NAMES)
        message.position = self._arm.q.tolist()
        self._states.publish(message)

    def _status(self) -> Status:
        return Status(
            WARN if self._rejected else OK,
            f'SIMULATED arm{"; " + self._problem if self._problem else ""}',
            {
                'simulated': True,
                'trajectories_accepted': self._accepted,
                'trajectories_rejected': self._rejected,
            },
        )


def _fields(message: JointTrajectory, start_s: float) -> Trajectory:
    """Return the fields of a message that the controller reads, with its start on its scale [s]."""
    points = message.points

    def rows(name: str) -> Floats:
        values = [getattr(point, name) for point in points]
        # Rows of different lengths become a shape that the controller rejects.
        even = len({len(each) for each in values}) == 1
        return np.array(values if even else [], np.float64)

    times = [p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in points]
    fields = (rows(name) for name in ('positions', 'velocities', 'accelerations'))
    return Trajectory(start_s, np.array(times, np.float64), *fields)


main = partial(run, VirtualArmNode)
