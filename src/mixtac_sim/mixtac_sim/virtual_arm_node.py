# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A simulated FR3 behind an emulated joint_trajectory_controller, as a node."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from mixtac_node.base_node import QOS_SENSOR, declare, ns_to_stamp, run, stamp_to_ns
from mixtac_node.diagnostics import OK, WARN, DiagnosticsPublisher, Status
from mixtac_sim.arm.fr3 import JOINT_NAMES, READY, violations
from mixtac_sim.arm.trajectory_controller import JointTrajectoryController, Release, Trajectory
from mixtac_sim.virtual_arm_parameters import VirtualArmParameters

if TYPE_CHECKING:
    from numpy.typing import NDArray

LIMITS_SEEN = 4
"""Commands that a jerk is computed from."""


class VirtualArmNode(Node):  # type: ignore[misc]
    """Accepts trajectories, follows them with a lag and publishes joint states.

    Cycles of the controller are computed when joint states are due; they lie on their own grid of
    host time, so that this makes no difference to the motion.
    """

    def __init__(self) -> None:
        super().__init__('virtual_arm', namespace='mixtac')
        parameters = declare(self, VirtualArmParameters)
        release: Release = 'humble' if parameters.release == 'humble' else 'jazzy'
        self._period_s = 1.0 / parameters.update_rate
        self._controller = JointTrajectoryController(parameters.update_rate, release=release)
        lag = parameters.tracking_lag
        self._keep = float(np.exp(-self._period_s / lag)) if lag > 0.0 else 0.0
        self._q = READY.copy()
        self._recent: list[NDArray[np.float64]] = []
        self._accepted = self._rejected = self._violations = 0
        self._problem = ''
        self._cycle_s = self._now_s()
        self._controller.reset(READY, self._cycle_s)
        self._states = self.create_publisher(JointState, parameters.joint_state_topic, QOS_SENSOR)
        self.create_subscription(
            JointTrajectory, parameters.trajectory_topic, self._on_trajectory, 10
        )
        self.create_timer(1.0 / parameters.state_rate, self._publish)
        self._diagnostics = DiagnosticsPublisher(self, 'virtual_arm', self._status)

    def _now_s(self) -> float:
        return float(self.get_clock().now().nanoseconds * 1e-9)

    def _on_trajectory(self, message: JointTrajectory) -> None:
        now_s = self._now_s()
        self._follow(now_s)
        reason = self._names_wrong(message.joint_names)
        if reason is None:
            reason = self._controller.accept(_fields(message), now_s)
        if reason is None:
            self._accepted += 1
            return
        self._rejected += 1
        self._problem = reason
        self.get_logger().warning(f'trajectory rejected: {reason}', throttle_duration_sec=2.0)

    def _names_wrong(self, names: list[str]) -> str | None:
        if tuple(names) == JOINT_NAMES:
            return None
        return f'joints {list(names)} are not {list(JOINT_NAMES)}'

    def _follow(self, now_s: float) -> None:
        """Run the controller's cycles up to a time."""
        while self._cycle_s <= now_s:
            command = self._controller.sample(self._cycle_s)[0]
            self._recent = [*self._recent[-LIMITS_SEEN + 1 :], command]
            if len(self._recent) == LIMITS_SEEN:
                self._violations += violations(np.stack(self._recent), self._period_s) > 0
            self._q = command + self._keep * (self._q - command)
            self._cycle_s += self._period_s

    def _publish(self) -> None:
        now = self.get_clock().now()
        self._follow(now.nanoseconds * 1e-9)
        message = JointState()
        message.header.stamp = ns_to_stamp(now.nanoseconds)
        message.name = list(JOINT_NAMES)
        message.position = self._q.tolist()
        self._states.publish(message)

    def _status(self) -> Status:
        bad = self._rejected or self._violations
        return Status(
            WARN if bad else OK,
            f'SIMULATED arm{"; " + self._problem if self._problem else ""}',
            {
                'simulated': True,
                'trajectories_accepted': self._accepted,
                'trajectories_rejected': self._rejected,
                'limit_violations': self._violations,
            },
        )


def _fields(message: JointTrajectory) -> Trajectory:
    """Return the fields of a message that the controller reads."""
    points = message.points

    def rows(name: str) -> NDArray[np.float64] | None:
        values = [getattr(point, name) for point in points]
        return np.array(values, np.float64) if values and all(len(v) for v in values) else None

    times = [p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in points]
    q = rows('positions')
    return Trajectory(
        1e-9 * stamp_to_ns(message.header.stamp),
        np.array(times, np.float64),
        np.empty((len(points), 0)) if q is None else q,
        rows('velocities'),
        rows('accelerations'),
    )


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run(VirtualArmNode, args)


if __name__ == '__main__':
    sys.exit(main())
