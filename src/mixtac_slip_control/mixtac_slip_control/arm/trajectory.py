# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Trajectories of stamped joint states: the type, its message, and settling at the measured place.

`TrajectoryMessage` fills `trajectory_msgs/JointTrajectory` without importing ROS.
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mixtac_slip_control.arm.kinematics import SerialArm
from mixtac_slip_control.errors import ArmError

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class PlannedTrajectory:
    """Joint states of the n joints of an arm at m times, ending at rest.

    Times are on the clock of the `now_s` that the planner was given: the host's ROS time.

    Attributes:
        stamp_ns: Time that `times_s` counts from [ns].
        times_s: Times of the points (m,) [s], above zero and rising.
        q: Joint positions (m, n) [rad].
        dq: Joint velocities (m, n) [rad/s].
        ddq: Joint accelerations (m, n) [rad/s2].
        names: Names of the joints.
        branch_s: Time since the stamp [s] from which it differs from the trajectory before it: it
            must be in effect by then.
    """

    stamp_ns: int
    times_s: Floats
    q: Floats
    dq: Floats
    ddq: Floats
    names: tuple[str, ...]
    branch_s: float = 0.0

    @property
    def stamp_s(self) -> float:
        """Time that `times_s` counts from [s]."""
        return self.stamp_ns * 1e-9

    @property
    def end_s(self) -> float:
        """Time at which the arm is at rest [s], on the planner's clock."""
        return self.stamp_s + float(self.times_s[-1])


@dataclass(frozen=True, slots=True, eq=False)
class ArmState:
    """Where an arm is.

    Attributes:
        stamp_s: Time of the measurement [s], on the clock of trajectories.
        q: Measured joint positions (n,) [rad].
        dq: Measured joint velocities (n,) [rad/s].
        commanded: Commanded joint positions (n,) [rad]; None where the backend does not
            know them.
    """

    stamp_s: float
    q: Floats
    dq: Floats
    commanded: Floats | None = None


NS_PER_S: Final = 1_000_000_000


class TrajectoryMessage:
    """One message that is filled again and again: creating points costs more than filling them.

    Attributes:
        message: The message, valid until the next `fill`.

    Args:
        message_type: `trajectory_msgs.msg.JointTrajectory`.
        point_type: `trajectory_msgs.msg.JointTrajectoryPoint`.
    """

    def __init__(self, message_type: type[Any], point_type: type[Any]) -> None:
        self.message = message_type()
        self._point_type = point_type
        self._pool: list[Any] = []

    def fill(self, trajectory: PlannedTrajectory) -> Any:  # noqa: ANN401
        """Return the message with the fields of a trajectory."""
        count = len(trajectory.times_s)
        while len(self._pool) < count:
            self._pool.append(self._point_type())
        stamp = self.message.header.stamp
        stamp.sec, stamp.nanosec = divmod(trajectory.stamp_ns, NS_PER_S)
        self.message.joint_names = list(trajectory.names)
        rows = (trajectory.times_s, trajectory.q, trajectory.dq, trajectory.ddq)
        for point, t, q, dq, ddq in zip(self._pool, *rows, strict=False):
            point.positions, point.velocities = _doubles(q), _doubles(dq)
            point.accelerations = _doubles(ddq)
            since = point.time_from_start
            since.sec, since.nanosec = divmod(round(t * NS_PER_S), NS_PER_S)
        self.message.points = self._pool[:count]
        return self.message


def _doubles(values: Floats) -> array[float]:
    # rclpy uses an array('d') without a copy and copies anything else number by number.
    return array('d', values.tobytes())


def settling_trajectory(
    arm: SerialArm, q: Floats, now_s: float, duration_s: float = 0.5
) -> PlannedTrajectory:
    """Return a trajectory of one point that leads a controller from its last command to rest at q.

    A controller's command differs from the measured positions by what the arm sags. The planner
    must start from the command: send this with the measured positions, wait until it ends, then
    reset the planner with the same positions. At 2 mrad and 0.5 s it takes 0.05 rad/s2.

    Args:
        arm: The arm.
        q: Joint positions to settle at (n,) [rad].
        now_s: Present time [s], on the controller's clock.
        duration_s: Time until it is there [s].

    Raises:
        ArmError: Invalid joint positions, or a duration out of range.
    """
    if not 0.05 <= duration_s <= 10.0:
        raise ArmError(f'settling in {duration_s} s: give 0.05 to 10 s')
    goal, rest = arm.checked(q)[None], np.zeros((1, arm.dof))
    return PlannedTrajectory(
        stamp_ns=round(now_s * 1e9),
        times_s=np.array([duration_s]),
        q=goal.copy(),
        dq=rest,
        ddq=rest.copy(),
        names=arm.names,
    )
