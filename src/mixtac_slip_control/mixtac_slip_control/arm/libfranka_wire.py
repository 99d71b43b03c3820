# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What passes between slip control and the process that talks to a Franka arm."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_slip_control.arm.planned_trajectory import PlannedTrajectory

    Floats = NDArray[np.float64]

JOINTS = 7
HEADER = struct.Struct('<qI')
"""Stamp [ns] and number of points; no points: come to rest and end."""
POINT_BYTES = 8 * (1 + 3 * JOINTS)
STATE = struct.Struct(f'<qI{3 * JOINTS}d')
"""Time [ns], trajectories refused as late, q, dq, commanded q."""
MAX_POINTS = 100_000
STOP = HEADER.pack(0, 0)


@dataclass(frozen=True, slots=True, eq=False)
class WireTrajectory:
    """A trajectory as received.

    Attributes:
        times_ns: Times of the points (m,) [ns].
        states: Positions, velocities, accelerations (m, 3, 7).
    """

    times_ns: NDArray[np.int64]
    states: Floats


def pack(trajectory: PlannedTrajectory) -> bytes:
    """Return the bytes of a trajectory of seven joints with at least one point."""
    states = np.stack([trajectory.q, trajectory.dq, trajectory.ddq], axis=1)
    header = HEADER.pack(trajectory.stamp_ns, len(trajectory.times_s))
    times = np.round(trajectory.times_s * 1e9).astype('<i8') + trajectory.stamp_ns
    return header + times.tobytes() + states.astype('<f8').tobytes()


class Receiver:
    """Cuts a stream of bytes into trajectories, dropping all but the latest.

    Attributes:
        stopped: Whether a stop was received, or bytes that are none of ours.
    """

    def __init__(self) -> None:
        self.stopped = False
        self._pending = bytearray()

    def push(self, data: bytes) -> WireTrajectory | None:
        """Take in bytes; return the latest complete trajectory among them, if any."""
        self._pending += data
        latest = None
        while not self.stopped and len(self._pending) >= HEADER.size:
            _, points = HEADER.unpack_from(self._pending)
            end = HEADER.size + points * POINT_BYTES
            if points == 0 or points > MAX_POINTS:
                self.stopped = True
            elif len(self._pending) < end:
                break
            else:
                latest = _unpack(bytes(self._pending[HEADER.size : end]), points)
                del self._pending[:end]
        return latest


def _unpack(body: bytes, points: int) -> WireTrajectory:
    times = np.frombuffer(body, '<i8', points).astype(np.int64)
    states = np.frombuffer(body, '<f8', offset=8 * points).reshape(points, 3, JOINTS)
    return WireTrajectory(times, states.astype(np.float64))
