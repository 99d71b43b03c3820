# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Kinematics of a serial chain given as arrays.

In NumPy: 0.06 ms for a pose and its Jacobian is enough for what is computed once per joint state or
per reset, and compiling it would take longer than all of that.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Flags = NDArray[np.bool_]

MAX_STEPS = 100
DAMPING = 1e-3
"""Of the damped steps at an error of 1 m or 1 rad; it shrinks with the error."""


def rotations(axes: Floats, angles: Floats) -> Floats:
    """Return the rotations (n, 3, 3) about unit axes (n, 3) by angles (n,) [rad] (Rodrigues)."""
    x, y, z = axes.T
    zero = np.zeros_like(x)
    cross = np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)
    sine, versine = np.sin(angles)[:, None, None], (1.0 - np.cos(angles))[:, None, None]
    return np.asarray(np.eye(3) + sine * cross + versine * (cross @ cross))


def pose_and_jacobian(
    origins: Floats, axes: Floats, prismatic: Flags, tool: Floats, q: Floats
) -> tuple[Floats, Floats]:
    """Return the pose of the tip (4, 4) and its Jacobian (6, n), in the base frame.

    Args:
        origins: Transform from each moving joint to the next (n, 4, 4).
        axes: Unit axes in the joints' frames (n, 3).
        prismatic: Whether a joint slides (n,).
        tool: Transform from the last joint to the tip (4, 4).
        q: Joint positions (n,) [rad or m].
    """
    turns = rotations(axes, np.where(prismatic, 0.0, q))
    slides = axes * np.where(prismatic, q, 0.0)[:, None]
    directions = np.empty((q.size, 3))
    points = np.empty((q.size, 3))
    R, p = np.eye(3), np.zeros(3)
    for i in range(q.size):
        p = p + R @ origins[i, :3, 3]
        R = R @ origins[i, :3, :3]
        directions[i] = R @ axes[i]
        p = p + R @ slides[i]
        R = R @ turns[i]
        points[i] = p
    pose = np.eye(4)
    pose[:3, 3] = p + R @ tool[:3, 3]
    pose[:3, :3] = R @ tool[:3, :3]
    linear = _cross(directions, pose[:3, 3] - points)
    turning = ~prismatic[:, None]
    return pose, np.concatenate(
        [np.where(turning, linear, directions), np.where(turning, directions, 0.0)], axis=1
    ).T


def _cross(a: Floats, b: Floats) -> Floats:
    (ax, ay, az), (bx, by, bz) = a.T, b.T
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx]).T


def pose_error(target: Floats, pose: Floats) -> Floats:
    """Return translation [m] and rotation vector [rad] (6,) that lead from a pose to a target."""
    error = np.empty(6)
    error[:3] = target[:3, 3] - pose[:3, 3]
    D = target[:3, :3] @ pose[:3, :3].T
    w = 0.5 * np.array([D[2, 1] - D[1, 2], D[0, 2] - D[2, 0], D[1, 0] - D[0, 1]])
    sine = np.sqrt(np.sum(w * w))
    cosine = 0.5 * (D[0, 0] + D[1, 1] + D[2, 2] - 1.0)
    angle = np.arctan2(sine, cosine)
    # Half a turn away the axis is lost here; any large step will do, the next one sees it again.
    scale = angle / sine if sine > 1e-9 else 1.0
    error[3:] = w * scale
    if sine <= 1e-9 and cosine < 0.0:
        error[3] += np.pi
    return error


def damped_inverse(jacobian: Floats, damping: float) -> Floats:
    """Return the damped pseudo-inverse (n, m) of a Jacobian (m, n)."""
    m = jacobian.shape[0]
    gram = jacobian @ jacobian.T + damping * damping * np.eye(m)
    return np.asarray(np.linalg.solve(gram, jacobian).T)


def inverse(
    origins: Floats,
    axes: Floats,
    prismatic: Flags,
    tool: Floats,
    target: Floats,
    start: Floats,
    tolerance: float,
) -> tuple[Floats, float]:
    """Return joint positions (n,) that reach a pose nearest to the start, and the error left.

    Damped least squares; what the pose leaves free is pulled back to the start.

    Args:
        origins: Transform from each moving joint to the next (n, 4, 4).
        axes: Unit axes in the joints' frames (n, 3).
        prismatic: Whether a joint slides (n,).
        tool: Transform from the last joint to the tip (4, 4).
        target: Wanted pose (4, 4).
        start: Joint positions to start from (n,).
        tolerance: Error at which the pose is reached [m and rad].
    """
    q = start.copy()
    for _ in range(MAX_STEPS):
        pose, jacobian = pose_and_jacobian(origins, axes, prismatic, tool, q)
        error = pose_error(target, pose)
        remaining = float(np.max(np.abs(error)))
        pinv = damped_inverse(jacobian, DAMPING * min(remaining, 1.0))
        back = start - q
        back = back - pinv @ (jacobian @ back)
        if remaining <= tolerance and np.max(np.abs(back)) <= 100.0 * tolerance:
            return q, remaining
        step = pinv @ error + back
        q = q + step * min(1.0, 0.5 / max(np.max(np.abs(step)), 1e-300))
    pose, _ = pose_and_jacobian(origins, axes, prismatic, tool, q)
    return q, float(np.max(np.abs(pose_error(target, pose))))
