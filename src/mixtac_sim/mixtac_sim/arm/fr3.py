# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Geometry and limits of the Franka Research 3, written down apart from those of the controller.

Modified Denavit-Hartenberg parameters, positions and torques: Franka's documentation and
franka_description; speeds: joint speed at mid range; acceleration and jerk: libfranka.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

JOINT_NAMES = tuple(f'fr3_joint{k}' for k in range(1, 8))
A_M = (0.0, 0.0, 0.0, 0.0825, -0.0825, 0.0, 0.088)
D_M = (0.333, 0.0, 0.316, 0.0, 0.384, 0.0, 0.0)
ALPHA = (0.0, -0.5 * np.pi, 0.5 * np.pi, 0.5 * np.pi, -0.5 * np.pi, 0.5 * np.pi, 0.5 * np.pi)
FLANGE_M = 0.107
READY = np.radians([0.0, -45.0, 0.0, -135.0, 0.0, 90.0, 45.0])
"""Ready pose [rad]."""
Q_LOWER = np.array([-2.7437, -1.7837, -2.9007, -3.0421, -2.8065, 0.5445, -3.0159])
Q_UPPER = np.array([2.7437, 1.7837, 2.9007, -0.1518, 2.8065, 4.5169, 3.0159])
"""Positions [rad]."""
DQ_MAX = np.array([2.62, 2.62, 2.62, 2.62, 5.26, 4.18, 5.26])
"""Speeds [rad/s]; near the ends of a joint's range less is allowed."""
DDQ_MAX = 10.0
"""Acceleration of every joint [rad/s2]."""
DDDQ_MAX = 5000.0
"""Jerk of every joint [rad/s3]."""


def flange_place(q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the place of the flange [3] [m] in the base frame.

    Args:
        q: Joint positions [7] [rad].
    """
    pose = np.eye(4)
    for a, d, alpha, angle in zip(A_M, D_M, ALPHA, q, strict=True):
        pose = pose @ _link(a, d, alpha, float(angle))
    return np.asarray(pose[:3, 3] + FLANGE_M * pose[:3, 2])


def _link(a: float, d: float, alpha: float, angle: float) -> NDArray[np.float64]:
    """Return one modified Denavit-Hartenberg transform."""
    ct, st, ca, sa = np.cos(angle), np.sin(angle), np.cos(alpha), np.sin(alpha)
    return np.array(
        [
            [ct, -st, 0.0, a],
            [st * ca, ct * ca, -sa, -d * sa],
            [st * sa, ct * sa, ca, d * ca],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def violations(q: NDArray[np.float64], period_s: float, reserve: float = 1e-3) -> int:
    """Return how many samples of a commanded motion break a limit.

    Args:
        q: Joint positions [n, 7] [rad], one per control cycle.
        period_s: Of the control cycle [s].
        reserve: Share of a limit by which rounding may exceed it.
    """
    dq = np.diff(q, axis=0) / period_s
    ddq = np.diff(dq, axis=0) / period_s
    dddq = np.diff(ddq, axis=0) / period_s
    room = 1.0 + reserve
    broken = [
        np.any((q < Q_LOWER) | (q > Q_UPPER), axis=1),
        np.any(np.abs(dq) > room * DQ_MAX, axis=1),
        np.any(np.abs(ddq) > room * DDQ_MAX, axis=1),
        np.any(np.abs(dddq) > room * DDDQ_MAX, axis=1),
    ]
    return int(sum(np.count_nonzero(each) for each in broken))
