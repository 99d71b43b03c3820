# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Kinematics of a serial arm from its URDF: pose and Jacobian of the tip, and the inverse.

Of the URDF only what kinematics and limits need is read: origins, axes, limits and the order of the
joints. Meshes and inertias are ignored. Expat is driven directly, so that a document type or an
entity, which a URDF does not need, ends the reading at once instead of being expanded.

Kinematics are in NumPy: 0.06 ms for a pose and its Jacobian is enough for what is computed once per
joint state or per reset, and compiling it would take longer than all of that.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from importlib import resources
from typing import NoReturn
from xml.etree import ElementTree as ET
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from mixtac_slip_control.errors import ArmError, RobotDescriptionError, UnreachableError

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]


MOVING = ('revolute', 'continuous', 'prismatic')
Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class UrdfJoint:
    """One joint as the URDF states it.

    Attributes:
        name: Name of the joint.
        kind: 'revolute', 'continuous', 'prismatic' or 'fixed'.
        parent: Link that carries it.
        child: Link it carries.
        xyz: Origin in the parent's frame [m].
        rpy: Roll, pitch, yaw of the origin in the parent's frame [rad].
        axis: Unit vector in the joint's frame.
        lower: Smallest position [rad or m]; -inf without a limit.
        upper: Largest position [rad or m].
        velocity: Largest speed [rad/s or m/s]; inf without a limit.
        effort: Largest torque or force [Nm or N]; inf without a limit.
    """

    name: str
    kind: str
    parent: str
    child: str
    xyz: Vector
    rpy: Vector
    axis: Vector
    lower: float = -math.inf
    upper: float = math.inf
    velocity: float = math.inf
    effort: float = math.inf


def read_chain(text: str, base: str = '', tip: str = '') -> tuple[UrdfJoint, ...]:
    """Return the joints from the base link to the tip link, fixed ones included.

    Args:
        text: The URDF.
        base: First link; empty: the root of the robot.
        tip: Last link; empty: the only leaf of the robot.

    Raises:
        RobotDescriptionError: No URDF, no such link, a branching or broken chain, or a joint of a
            kind that a serial arm has no use for.
    """
    root = _parse(text)
    if root.tag != 'robot':
        raise RobotDescriptionError(f'the URDF starts with <{root.tag}>: give one with <robot>')
    joints = [_joint(element) for element in root.findall('joint')]
    by_child = {joint.child: joint for joint in joints}
    link = tip or _leaf(joints)
    chain: list[UrdfJoint] = []
    while link != base and link in by_child:
        chain.append(by_child.pop(link))
        link = chain[-1].parent
    if (base and link != base) or not chain:
        raise RobotDescriptionError(
            f'the URDF has no chain of joints from {base or "its root"!r} to {tip!r}: links with '
            f'a parent are {sorted(j.child for j in joints)}'
        )
    chain.reverse()
    for joint in chain:
        if joint.kind not in (*MOVING, 'fixed'):
            raise RobotDescriptionError(
                f'joint {joint.name!r} is {joint.kind!r}: a serial arm may hold {MOVING} and fixed'
            )
    return tuple(chain)


def _parse(text: str) -> ET.Element:
    builder = ET.TreeBuilder()
    parser = expat.ParserCreate()

    def refuse(*_arguments: object) -> NoReturn:
        raise RobotDescriptionError(
            'the URDF declares a document type or an entity: expand xacro first and give plain XML'
        )

    parser.StartDoctypeDeclHandler = refuse
    parser.EntityDeclHandler = refuse
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        raise RobotDescriptionError(f'the URDF is no well-formed XML: {error}') from error
    return builder.close()


def _leaf(joints: list[UrdfJoint]) -> str:
    parents = {joint.parent for joint in joints}
    leaves = [joint.child for joint in joints if joint.child not in parents]
    if len(leaves) != 1:
        raise RobotDescriptionError(f'the URDF ends in the links {leaves}: name the tip link')
    return leaves[0]


def _joint(element: ET.Element) -> UrdfJoint:
    name = element.get('name', '')
    kind = element.get('type', '')
    parent, child = element.find('parent'), element.find('child')
    if parent is None or child is None:
        raise RobotDescriptionError(f'joint {name!r} lacks its parent or child link')
    origin, limit = element.find('origin'), element.find('limit')
    return UrdfJoint(
        name=name,
        kind=kind,
        parent=parent.get('link', ''),
        child=child.get('link', ''),
        xyz=_vector(origin, 'xyz', (0.0, 0.0, 0.0), name),
        rpy=_vector(origin, 'rpy', (0.0, 0.0, 0.0), name),
        axis=_unit(_vector(element.find('axis'), 'xyz', (1.0, 0.0, 0.0), name), name),
        # A missing bound of a revolute or prismatic joint is zero in the URDF specification.
        lower=_number(limit, 'lower', 0.0 if _bounded(kind, limit) else -math.inf, name),
        upper=_number(limit, 'upper', 0.0 if _bounded(kind, limit) else math.inf, name),
        velocity=_number(limit, 'velocity', math.inf, name),
        effort=_number(limit, 'effort', math.inf, name),
    )


def _bounded(kind: str, limit: ET.Element | None) -> bool:
    return kind in ('revolute', 'prismatic') and limit is not None


def _number(element: ET.Element | None, key: str, default: float, joint: str) -> float:
    text = None if element is None else element.get(key)
    if text is None:
        return default
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if math.isnan(value):
        raise RobotDescriptionError(f'joint {joint!r}: {key}="{text}" is no number')
    return value


def _vector(element: ET.Element | None, key: str, default: Vector, joint: str) -> Vector:
    text = None if element is None else element.get(key)
    if text is None:
        return default
    try:
        x, y, z = (float(part) for part in text.split())
    except ValueError:
        x = y = z = math.nan
    if not math.isfinite(x + y + z):
        raise RobotDescriptionError(f'joint {joint!r}: {key}="{text}" is not three numbers')
    return x, y, z


def _unit(axis: Vector, joint: str) -> Vector:
    length = math.hypot(*axis)
    if length < 1e-9:
        raise RobotDescriptionError(f'joint {joint!r} has an axis of length zero')
    return axis[0] / length, axis[1] / length, axis[2] / length


MAX_INVERSE_STEPS = 100
DAMPING = 1e-3
"""Damping of the inverse at an error of 1 m or 1 rad; it shrinks with the error."""


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
    for _ in range(MAX_INVERSE_STEPS):
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


FR3_READY = (0.0, -math.pi / 4, 0.0, -3 * math.pi / 4, 0.0, math.pi / 2, math.pi / 4)
"""Ready pose of the FR3 [rad], from libfranka's examples."""


class SerialArm:
    """A chain of revolute and prismatic joints from a base link to a tip link.

    All vectors are in the frame of the base link unless stated otherwise; the Jacobian's rows are
    the linear velocity of the tip's origin [m/s], then the angular velocity [rad/s].

    Attributes:
        joints: The moving joints, in order.
        names: Their names.
        dof: Their number n.

    Args:
        joints: Chain with fixed joints, as `read_chain` returns it.

    Raises:
        RobotDescriptionError: No joint moves.
    """

    def __init__(self, joints: tuple[UrdfJoint, ...]) -> None:
        self.joints = tuple(joint for joint in joints if joint.kind in MOVING)
        if not self.joints:
            raise RobotDescriptionError('no joint of the chain moves: name other links')
        self.names = tuple(joint.name for joint in self.joints)
        self.dof = len(self.joints)
        self._axes = np.array([joint.axis for joint in self.joints])
        self._prismatic = np.array([joint.kind == 'prismatic' for joint in self.joints])
        self._origins = np.empty((self.dof, 4, 4))
        pending = np.eye(4)
        moving = 0
        for joint in joints:
            pending = pending @ _origin(joint)
            if joint.kind in MOVING:
                self._origins[moving] = pending
                pending = np.eye(4)
                moving += 1
        self._tool = pending

    @classmethod
    def from_urdf(cls, text: str, base: str = '', tip: str = '') -> SerialArm:
        """Read an arm from a URDF.

        Args:
            text: The URDF, for example from `/robot_description`.
            base: First link; empty: the root.
            tip: Last link; empty: the only leaf.

        Raises:
            RobotDescriptionError: See `read_chain`.
        """
        return cls(read_chain(text, base, tip))

    @classmethod
    def fr3(cls) -> SerialArm:
        """Return a Franka Research 3 up to its flange, from the description shipped here."""
        return cls.from_urdf(fr3_urdf())

    def pose(self, q: Floats) -> Floats:
        """Return the pose of the tip (4, 4), translation in m.

        Args:
            q: Joint positions (n,) [rad or m].

        Raises:
            ArmError: `q` has another length or is not finite.
        """
        return self._pose_and_jacobian(q)[0]

    def jacobian(self, q: Floats) -> Floats:
        """Return the Jacobian of the tip (6, n) at joint positions (n,).

        Raises:
            ArmError: `q` has another length or is not finite.
        """
        return self._pose_and_jacobian(q)[1]

    def solve(self, pose: Floats, q: Floats, tolerance: float = 1e-12) -> Floats:
        """Return joint positions (n,) that bring the tip to a pose, near the given ones.

        Redundant joints stay as near to `q` as the pose allows. Limits are not looked at.

        Args:
            pose: Wanted pose of the tip (4, 4).
            q: Where to start, and the posture to stay near (n,).
            tolerance: Largest error of position [m] and orientation [rad].

        Raises:
            UnreachableError: The pose is out of reach or behind a singularity.
            ArmError: `q` has another length or is not finite.
        """
        start = self.checked(q)
        target = np.ascontiguousarray(pose, dtype=np.float64)
        solution, error = inverse(
            self._origins, self._axes, self._prismatic, self._tool, target, start, tolerance
        )
        if not error <= tolerance:
            x, y, z = target[:3, 3]
            raise UnreachableError(
                f'the arm cannot bring its tip to ({x:.4f}, {y:.4f}, {z:.4f}) m from joint '
                f'positions {np.round(start, 3).tolist()}: error {error:.3g} remains; choose a '
                'nearer target or another posture'
            )
        return np.asarray(solution)

    def checked(self, q: Floats) -> Floats:
        """Return joint positions as a contiguous array (n,).

        Raises:
            ArmError: Another length, or not finite.
        """
        values = np.ascontiguousarray(q, dtype=np.float64)
        if values.shape != (self.dof,) or not np.isfinite(values).all():
            raise ArmError(
                f'joint positions {values.tolist()}: give {self.dof} finite numbers, for '
                f'{", ".join(self.names)}'
            )
        return values

    def _pose_and_jacobian(self, q: Floats) -> tuple[Floats, Floats]:
        pose, jacobian = pose_and_jacobian(
            self._origins, self._axes, self._prismatic, self._tool, self.checked(q)
        )
        return pose, jacobian


def fr3_urdf() -> str:
    """Return the mesh-free URDF of the Franka Research 3 that is shipped here."""
    return (resources.files(__package__) / 'models' / 'fr3.urdf').read_text(encoding='utf-8')


def _origin(joint: UrdfJoint) -> Floats:
    """Return the transform of a joint's origin (4, 4): translation, then fixed-axis r, p, y."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(joint.rpy), np.sin(joint.rpy)
    transform = np.eye(4)
    transform[:3, :3] = (
        (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
        (-sp, cp * sr, cp * cr),
    )
    transform[:3, 3] = joint.xyz
    return transform
