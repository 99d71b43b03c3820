# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Fills trajectory_msgs/JointTrajectory from a planned trajectory, without importing ROS."""

from __future__ import annotations

from array import array
from typing import TYPE_CHECKING, Generic, Protocol, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, MutableSequence, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from mixtac_slip_control.arm.planned_trajectory import PlannedTrajectory

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
