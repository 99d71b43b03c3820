# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The joints of a serial arm, read from a URDF.

Only what kinematics and limits need: origins, axes, limits and the order of the joints. Meshes and
inertias are passed over. Expat is driven directly, so that a document type or an entity, which a
URDF has no use for, ends the reading at once instead of being expanded.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET
from xml.parsers import expat

from mixtac_slip_control.errors import RobotDescriptionError

if TYPE_CHECKING:
    from typing import NoReturn


MOVING = ('revolute', 'continuous', 'prismatic')
Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class UrdfJoint:
    """One joint as the URDF states it.

    Attributes:
        name: Of the joint.
        kind: 'revolute', 'continuous', 'prismatic' or 'fixed'.
        parent: Link it hangs on.
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
