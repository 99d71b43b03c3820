# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Trajectories of stamped joint states: the type, its message, what carries it out, and approaches.

`TrajectoryMessage` fills `trajectory_msgs/JointTrajectory` without importing ROS. `ArmBackend` is
the interface of whatever drives the arm along trajectories. `approach_trajectory` and
`settling_trajectory` are motions from rest to rest before slip control: to the object, and onto the
commanded state.
"""

from __future__ import annotations

import math
from array import array
from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic, Protocol, TypeVar

import numpy as np

from mixtac_slip_control.errors import ArmError, UnreachableError

if TYPE_CHECKING:
    from collections.abc import Callable, MutableSequence, Sequence

    from numpy.typing import NDArray

    from mixtac_slip_control.arm.kinematics import SerialArm
    from mixtac_slip_control.arm.limits import JointLimits

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
        names: Of the joints.
        branch_s: From here on, in seconds since the stamp, it differs from the trajectory before
            it: it must be in effect by then.
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


NS_PER_S = 1_000_000_000


class _Time(Protocol):
    sec: int
    nanosec: int


class _Header(Protocol):
    @property
    def stamp(self) -> _Time: ...


class _Point(Protocol):
    positions: MutableSequence[float]
    velocities: MutableSequence[float]
    accelerations: MutableSequence[float]

    @property
    def time_from_start(self) -> _Time: ...


Point = TypeVar('Point', bound=_Point)


class _Message(Protocol, Generic[Point]):
    joint_names: Sequence[str]
    points: Sequence[Point]

    @property
    def header(self) -> _Header: ...


Message = TypeVar('Message', bound=_Message)  # type: ignore[type-arg]


class TrajectoryMessage(Generic[Message]):
    """One message that is filled again and again: creating points costs more than filling them.

    Attributes:
        message: The message, valid until the next `fill`.

    Args:
        message_type: `trajectory_msgs.msg.JointTrajectory`.
        point_type: `trajectory_msgs.msg.JointTrajectoryPoint`.
    """

    def __init__(
        self, message_type: Callable[[], Message], point_type: Callable[[], Point]
    ) -> None:
        self.message = message_type()
        self._point_type: Callable[[], _Point] = point_type
        self._pool: list[_Point] = []

    def fill(self, trajectory: PlannedTrajectory, *, stamped: bool = True) -> Message:
        """Return the message with the fields of a trajectory.

        Args:
            trajectory: What to send.
            stamped: False leaves the stamp zero, which controllers read as "from now on".
        """
        count = len(trajectory.times_s)
        while len(self._pool) < count:
            self._pool.append(self._point_type())
        stamp = self.message.header.stamp
        stamp.sec, stamp.nanosec = divmod(trajectory.stamp_ns if stamped else 0, NS_PER_S)
        self.message.joint_names = list(trajectory.names)
        rows = (trajectory.times_s, trajectory.q, trajectory.dq, trajectory.ddq)
        for point, t, q, dq, ddq in zip(self._pool, *rows, strict=False):
            point.positions, point.velocities = _doubles(q), _doubles(dq)
            point.accelerations = _doubles(ddq)
            since = point.time_from_start
            since.sec, since.nanosec = divmod(round(t * NS_PER_S), NS_PER_S)
        self.message.points = self._pool[:count]
        return self.message


def _doubles(values: NDArray[np.float64]) -> MutableSequence[float]:
    # rclpy takes an array('d') as it is and copies anything else number by number.
    return array('d', values.tobytes())


@dataclass(frozen=True, slots=True, eq=False)
class ArmState:
    """Where an arm is.

    Attributes:
        stamp_s: Time of the measurement [s], on the host's clock.
        q: Measured joint positions (n,) [rad].
        dq: Measured joint velocities (n,) [rad/s].
        commanded: Commanded joint positions (n,) [rad]; None where the backend cannot tell.
    """

    stamp_s: float
    q: Floats
    dq: Floats
    commanded: Floats | None = None


class ArmBackend(Protocol):
    """Drives an arm along planned trajectories.

    Implementations: the node's publisher of `trajectory_msgs/JointTrajectory`, and
    `LibfrankaBackend`, which needs no ros2_control.
    """

    def state(self) -> ArmState | None:
        """Return the latest state, or None before the first.

        Raises:
            BackendError: The arm or the way to it reports a fault.
        """

    def send(self, trajectory: PlannedTrajectory) -> None:
        """Replace the trajectory being carried out by another, at once.

        Raises:
            BackendError: The arm or the way to it reports a fault.
        """

    def stop(self) -> None:
        """Bring the arm to rest and let go of it."""


# Largest derivatives of the quintic from rest to rest over a unit distance in a unit time.
PEAK_VELOCITY = 1.875
PEAK_ACCELERATION = 10.0 / math.sqrt(3.0)
PEAK_JERK = 60.0


def approach_trajectory(
    arm: SerialArm,
    limits: JointLimits,
    start: Floats,
    goal: Floats,
    share: float = 0.3,
    spacing_s: float = 0.02,
) -> PlannedTrajectory:
    """Return a quintic in joint space from rest to rest, all joints together.

    The stamp is zero: it begins when the controller takes it up. It serves as the trajectory of a
    FollowJointTrajectory goal.

    Args:
        arm: The arm, for the names of its joints.
        limits: Of its joints.
        start: Joint positions at the start (n,) [rad].
        goal: Joint positions at the end (n,) [rad].
        share: Of the velocity, acceleration and jerk limits that may be used.
        spacing_s: Time between points [s].

    Raises:
        ArmError: Positions or a share that are none.
        UnreachableError: Start or goal outside the joints' ranges.
    """
    a, b = arm.checked(start), arm.checked(goal)
    for name, q in (('start', a), ('goal', b)):
        problem = limits.violation(q, arm.names)
        if problem is not None:
            raise UnreachableError(f'the {name} of the approach: {problem}')
    if not 0.0 < share <= 1.0 or not spacing_s > 0.0:
        raise ArmError(
            f'share = {share}, spacing_s = {spacing_s}: give 0 < share <= 1, spacing > 0'
        )
    duration = max(_duration(limits, np.abs(b - a), np.linspace(a, b, 50), share), spacing_s)
    count = math.ceil(duration / spacing_s)
    return _quintic(a, b, duration, np.arange(1, count + 1) / count, arm.names)


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
        ArmError: Joint positions or a duration that are none.
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


def _duration(limits: JointLimits, distance: Floats, line: Floats, share: float) -> float:
    """Return the shortest time [s] of the quintic within a share of the limits."""
    bounds = [limits.velocity_bounds(q) for q in line]
    speed = share * np.min([np.minimum(-low, high) for low, high in bounds], axis=0)
    moving = distance > 0.0
    if (speed[moving] <= 0.0).any():
        raise UnreachableError(
            'the approach starts or ends where the velocity limit of a joint is zero: keep away '
            'from the ends of the joints'
        )
    times = (
        PEAK_VELOCITY * distance[moving] / speed[moving],
        np.sqrt(PEAK_ACCELERATION * distance[moving] / (share * limits.acceleration[moving])),
        np.cbrt(PEAK_JERK * distance[moving] / (share * limits.jerk[moving])),
    )
    return max((float(t.max()) for t in times if t.size), default=0.0)


def _quintic(
    start: Floats, goal: Floats, duration: float, u: Floats, names: tuple[str, ...]
) -> PlannedTrajectory:
    """Return points at shares u (m,) of the duration [s]."""
    x = u[:, None]
    step = goal - start
    return PlannedTrajectory(
        stamp_ns=0,
        times_s=u * duration,
        q=start + step * x**3 * (10.0 + x * (6.0 * x - 15.0)),
        dq=step * 30.0 * x**2 * (1.0 - x) ** 2 / duration,
        ddq=step * 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / duration**2,
        names=names,
    )
