# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Kinematics of a serial arm from its URDF: pose and Jacobian of the tip.

Only what kinematics and limits need is read from the URDF: origins, axes, limits and the order of
the joints. Meshes and inertias are ignored. A document type, which a URDF does not need and which
could declare entities, is refused before the text is parsed.

Kinematics are in NumPy: a pose and its Jacobian take 0.06 ms, and are computed once per joint state
and once per enabling.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from importlib import resources
from xml.etree import ElementTree as ET

import numpy as np

from mixtac_core.events.arrays import Floats
from mixtac_slip_control.errors import ArmError

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


def read_chain(text: str) -> tuple[UrdfJoint, ...]:
    """Return the joints from the root link to the only leaf, fixed ones included.

    Args:
        text: The URDF.

    Raises:
        ArmError: No URDF, a branching chain, or a joint that follows another one or is of a kind
            that a serial arm has no use for.
    """
    if '<!DOCTYPE' in text:
        raise ArmError('the URDF declares a document type: expand xacro first and give plain XML')
    try:
        root = ET.fromstring(text)  # noqa: S314  (no entities without a document type)
    except (ET.ParseError, ValueError) as error:
        raise ArmError(f'the URDF is no well-formed XML: {error}') from error
    if root.tag != 'robot':
        raise ArmError(f'the URDF starts with <{root.tag}>: give one with <robot>')
    joints = [_joint(element) for element in root.findall('joint')]
    by_child = {joint.child: joint for joint in joints}
    leaves = by_child.keys() - {joint.parent for joint in joints}
    if len(leaves) != 1:
        raise ArmError(
            f'the URDF ends in the links {sorted(leaves)}: give one with a single chain of joints'
        )
    (link,) = leaves
    chain: list[UrdfJoint] = []
    while link in by_child:
        chain.append(by_child.pop(link))
        link = chain[-1].parent
    chain.reverse()
    for joint in chain:
        if joint.kind not in (*MOVING, 'fixed'):
            raise ArmError(
                f'joint {joint.name!r} is {joint.kind!r}: a serial arm may hold {MOVING} and fixed'
            )
    return tuple(chain)


def _joint(element: ET.Element) -> UrdfJoint:
    name = element.get('name', '')
    kind = element.get('type', '')
    parent, child = element.find('parent'), element.find('child')
    if parent is None or child is None:
        raise ArmError(f'joint {name!r} lacks its parent or child link')
    if element.find('mimic') is not None:
        raise ArmError(
            f'joint {name!r} follows another one (<mimic>), which a serial arm cannot: give a '
            'chain of joints that move by themselves'
        )
    origin, limit = element.find('origin'), element.find('limit')
    x, y, z = _vector(element.find('axis'), 'xyz', (1.0, 0.0, 0.0), name)
    length = math.hypot(x, y, z)
    if length < 1e-9:
        raise ArmError(f'joint {name!r} has an axis of length zero')
    bound = 0.0 if limit is not None and kind in ('revolute', 'prismatic') else math.inf
    return UrdfJoint(
        name=name,
        kind=kind,
        parent=parent.get('link', ''),
        child=child.get('link', ''),
        xyz=_vector(origin, 'xyz', (0.0, 0.0, 0.0), name),
        rpy=_vector(origin, 'rpy', (0.0, 0.0, 0.0), name),
        axis=(x / length, y / length, z / length),
        # A missing bound of a revolute or prismatic joint is zero in the URDF specification.
        lower=_number(limit, 'lower', -bound, name),
        upper=_number(limit, 'upper', bound, name),
        velocity=_number(limit, 'velocity', math.inf, name),
    )


def _number(element: ET.Element | None, key: str, default: float, joint: str) -> float:
    (value,) = _numbers(element, key, (default,), joint)
    return value


def _vector(element: ET.Element | None, key: str, default: Vector, joint: str) -> Vector:
    x, y, z = _numbers(element, key, default, joint)
    if not math.isfinite(x + y + z):
        raise ArmError(f'joint {joint!r}: {key} is not three finite numbers')
    return x, y, z


def _numbers(
    element: ET.Element | None, key: str, default: tuple[float, ...], joint: str
) -> tuple[float, ...]:
    text = None if element is None else element.get(key)
    if text is None:
        return default
    try:
        values = tuple(float(part) for part in text.split())
    except ValueError:
        values = ()
    if len(values) != len(default) or any(map(math.isnan, values)):
        raise ArmError(f'joint {joint!r}: {key}="{text}" is not {len(default)} numbers')
    return values


def rotations(axes: Floats, angles: Floats) -> Floats:
    """Return the rotations (n, 3, 3) about unit axes (n, 3) by angles (n,) [rad] (Rodrigues)."""
    x, y, z = axes.T
    zero = np.zeros_like(x)
    cross = np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)
    sine, versine = np.sin(angles)[:, None, None], (1.0 - np.cos(angles))[:, None, None]
    return np.asarray(np.eye(3) + sine * cross + versine * (cross @ cross))


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
        ArmError: No joint moves.
    """

    def __init__(self, joints: tuple[UrdfJoint, ...]) -> None:
        self.joints = tuple(joint for joint in joints if joint.kind in MOVING)
        if not self.joints:
            raise ArmError('no joint of the chain moves: name other links')
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
    def from_urdf(cls, text: str) -> SerialArm:
        """Read an arm from a URDF.

        Args:
            text: The URDF, for example from `/robot_description`.

        Raises:
            ArmError: See `read_chain`.
        """
        return cls(read_chain(text))

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
        return self._pose_and_jacobian(self.checked(q))[0]

    def jacobian(self, q: Floats) -> Floats:
        """Return the Jacobian of the tip (6, n) at joint positions (n,).

        Raises:
            ArmError: `q` has another length or is not finite.
        """
        return self._pose_and_jacobian(self.checked(q))[1]

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
        turns = rotations(self._axes, np.where(self._prismatic, 0.0, q))
        slides = self._axes * np.where(self._prismatic, q, 0.0)[:, None]
        directions = np.empty((self.dof, 3))
        points = np.empty((self.dof, 3))
        R, p = np.eye(3), np.zeros(3)
        for i in range(self.dof):
            p = p + R @ self._origins[i, :3, 3]
            R = R @ self._origins[i, :3, :3]
            directions[i] = R @ self._axes[i]
            p = p + R @ slides[i]
            R = R @ turns[i]
            points[i] = p
        pose = np.eye(4)
        pose[:3, 3] = p + R @ self._tool[:3, 3]
        pose[:3, :3] = R @ self._tool[:3, :3]
        linear = np.cross(directions, pose[:3, 3] - points)
        turning = ~self._prismatic[:, None]
        moves, turned = np.where(turning, linear, directions), np.where(turning, directions, 0.0)
        return pose, np.concatenate([moves, turned], axis=1).T


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
