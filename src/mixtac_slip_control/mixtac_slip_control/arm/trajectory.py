# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Trajectories of stamped joint states: the type, its message, and settling at the measured place.

`serialised` writes `trajectory_msgs/JointTrajectory` without importing ROS.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from typing import Final

import numpy as np

from mixtac_core.events.arrays import Floats
from mixtac_core.events.packets import CDR_LITTLE_ENDIAN
from mixtac_slip_control.arm.kinematics import SerialArm


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
        commanded: Commanded joint positions (n,) [rad]; None where the backend does not report
            them.
    """

    stamp_s: float
    q: Floats
    commanded: Floats | None = None


NS_PER_S: Final = 1_000_000_000


def serialised(trajectory: PlannedTrajectory) -> bytes:
    """Return a trajectory as a serialised `trajectory_msgs/JointTrajectory`.

    In the step that responds to a slip, this costs a fraction of filling and converting a message.
    """
    count, joints = trajectory.q.shape
    text = struct.pack('<iII', *divmod(trajectory.stamp_ns, NS_PER_S), 1) + b'\0'
    text += bytes(-len(text) % 4) + struct.pack('<I', joints)
    for name in trajectory.names:
        data = name.encode() + b'\0'
        text += bytes(-len(text) % 4) + struct.pack('<I', len(data)) + data
    text += bytes(-len(text) % 4) + struct.pack('<I', count)
    # Numbers of eight bytes lie at multiples of eight, their count before them. So a point is a row
    # of words of four bytes: positions, then velocities and accelerations after two words each, no
    # effort, and the time, which ends halfway between two multiples.
    words = np.zeros((count, 6 * joints + 8), '<i4')
    first, numbers = 1, 2 * joints
    for values in (trajectory.q, trajectory.dq, trajectory.ddq):
        words[:, first : first + numbers] = np.ascontiguousarray(values, '<f8').view('<i4')
        first += numbers + 2
    words[:, 0] = words[:, numbers + 1] = words[:, 2 * numbers + 3] = joints
    words[:, -2:] = np.stack(divmod(np.rint(trajectory.times_s * NS_PER_S), NS_PER_S), axis=1)
    points = words.tobytes()
    if len(text) % 8 == 0:
        points = points[:4] + bytes(4) + points[4:]
    return CDR_LITTLE_ENDIAN + bytes(2) + text + points


PEAK_ACCELERATION: Final = 10.0 / math.sqrt(3.0)
"""Largest acceleration of a quintic from rest to rest, times its squared duration over its way."""
PEAK_JERK: Final = 60.0
"""Largest jerk of such a quintic, times its cubed duration over its way."""
PEAK_SPEED: Final = 1.875
"""Largest speed of such a quintic, times its duration over its way."""


def settling_time(way: float, velocity: float, acceleration: float, jerk: float) -> float:
    """Return the time in which a quintic from rest to rest keeps the limits [s].

    Args:
        way: Largest motion of a joint [rad].
        velocity: Limit of the joint's speed [rad/s].
        acceleration: Limit of its acceleration [rad/s2].
        jerk: Limit of its jerk [rad/s3].
    """
    return max(
        PEAK_SPEED * way / velocity,
        math.sqrt(PEAK_ACCELERATION * way / acceleration),
        float(np.cbrt(PEAK_JERK * way / jerk)),
    )


def settling_trajectory(
    arm: SerialArm, q: Floats, now_s: float, duration_s: float
) -> PlannedTrajectory:
    """Return a trajectory of one point that leads a controller from its last command to rest at q.

    The command of a controller differs from the measured positions by the sag of the arm, but the
    planner must start from the command. Send this trajectory with the measured positions, wait
    until it ends, then let the planner move.

    Args:
        arm: The arm.
        q: Joint positions to settle at (n,) [rad].
        now_s: Present time [s], on the controller's clock.
        duration_s: Time until the arm is there [s], see `settling_time`.

    Raises:
        ArmError: Invalid joint positions.
    """
    goal, rest = arm.checked(q)[None], np.zeros((1, arm.dof))
    return PlannedTrajectory(
        stamp_ns=round(now_s * 1e9),
        times_s=np.array([duration_s]),
        q=goal.copy(),
        dq=rest,
        ddq=rest.copy(),
        names=arm.names,
    )
