# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The Franka Research 3: geometry, limits, and a model for MuJoCo (MJCF).

Written independently of the controller's own geometry. Modified Denavit-Hartenberg parameters,
positions and torques: Franka's documentation and franka_description; speeds: joint speed at mid
range; acceleration and jerk: libfranka. The MuJoCo model (``fr3.xml``) gets position servos and a
gel at its flange.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from string import Template
from typing import Final

import numpy as np

from mixtac_events.arrays import Floats

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


def flange_place(q: Floats) -> Floats:
    """Return the place of the flange [3] [m] in the base frame.

    Args:
        q: Joint positions [7] [rad].
    """
    pose = np.eye(4)
    for a, d, alpha, angle in zip(A_M, D_M, ALPHA, q, strict=True):
        pose = pose @ _link(a, d, alpha, float(angle))
    return np.asarray(pose[:3, 3] + FLANGE_M * pose[:3, 2])


def _link(a: float, d: float, alpha: float, angle: float) -> Floats:
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


def violations(q: Floats, period_s: float) -> int:
    """Return how many samples of a commanded motion break a limit.

    Args:
        q: Joint positions [n, 7] [rad], one per control cycle.
        period_s: Period of the control cycle [s].
    """
    dq = np.diff(q, axis=0) / period_s
    ddq = np.diff(dq, axis=0) / period_s
    dddq = np.diff(ddq, axis=0) / period_s
    # Rounding may exceed a limit by a thousandth.
    room = 1.0 + 1e-3
    broken = [
        np.any((q < Q_LOWER) | (q > Q_UPPER), axis=1),
        np.any(np.abs(dq) > room * DQ_MAX, axis=1),
        np.any(np.abs(ddq) > room * DDQ_MAX, axis=1),
        np.any(np.abs(dddq) > room * DDDQ_MAX, axis=1),
    ]
    return int(sum(np.count_nonzero(each) for each in broken))


TORQUE_MAX_NM: Final = (87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0)
GEL_KG: Final = 0.1
"""Mass that moves with the surface of the gel [kg]; a smaller one would need smaller steps."""
GEL_DAMPING_RATIO: Final = 0.05
"""Damping ratio of that mass on the spring; losses of the gel are modelled with the grasp."""
GEL_RADIUS_M: Final = 0.005
GEL_REACH_M: Final = 0.02
"""From the flange to the surface of the gel."""
WALL_M: Final = 0.05
"""Half the edge of what it presses against."""


@dataclass(frozen=True, slots=True)
class GelContact:
    """Contact of the flange: a gel as a spring between it and a wall.

    Attributes:
        place_m: Position of the flange in the base frame [3] [m].
        normal: Direction of the advance in the base frame [3], of length 1.
        normal_in_flange: The same in the flange's frame [3].
        n_per_m: Stiffness of the gel [N/m].
        preload_n: Force at the start [N].
    """

    place_m: Sequence[float]
    normal: Sequence[float]
    normal_in_flange: Sequence[float]
    n_per_m: float
    preload_n: float


def fr3_mjcf(
    contact: GelContact | None = None, stiffness_nm: Sequence[float] = (), lag_s: float = 0.0
) -> str:
    """Return the model.

    Args:
        contact: Contact of the flange; None for free motion.
        stiffness_nm: Torque per error of position of the servo of each joint [7] [N m/rad]; none
            for no actuators.
        lag_s: Lag with which a joint follows: its damping over its stiffness [s].
    """
    model = Template(Path(__file__).with_name('fr3.xml').read_text(encoding='utf-8'))
    return model.substitute(
        wall=_wall(contact) if contact else '',
        gel=_gel(contact) if contact else '',
        actuators=_actuators(stiffness_nm, lag_s) if stiffness_nm else '',
    )


def _gel(contact: GelContact) -> str:
    """Return the surface of the gel, on a spring along the normal."""
    axis = _words(contact.normal_in_flange)
    place = _words([GEL_REACH_M * n for n in contact.normal_in_flange])
    damping = 2.0 * GEL_DAMPING_RATIO * math.sqrt(contact.n_per_m * GEL_KG)
    return (
        f'<body name="gel" pos="0 0 {FLANGE_M}" gravcomp="1">'
        f'<inertial pos="{place}" mass="{GEL_KG}" diaginertia="1e-5 1e-5 1e-5"/>'
        f'<joint name="gel" type="slide" axis="{axis}" stiffness="{contact.n_per_m}" '
        f'springref="{contact.preload_n / contact.n_per_m}" damping="{damping}"/>'
        f'<geom name="gel" type="sphere" size="{GEL_RADIUS_M}" pos="{place}" mass="0" '
        'solref="0.0005 1" solimp="0.99 0.999 1e-5"/></body>'
    )


def _wall(contact: GelContact) -> str:
    """Return the wall that the gel touches at the start."""
    ahead = GEL_REACH_M + GEL_RADIUS_M + WALL_M
    place = [p + ahead * n for p, n in zip(contact.place_m, contact.normal, strict=True)]
    x, y, z = contact.normal
    return (
        f'<geom name="wall" type="box" size="{WALL_M} {WALL_M} {WALL_M}" pos="{_words(place)}" '
        f'zaxis="{x} {y} {z}" solref="0.0005 1" solimp="0.99 0.999 1e-5"/>'
    )


def _actuators(stiffness_nm: Sequence[float], lag_s: float) -> str:
    rows = zip(JOINT_NAMES, stiffness_nm, TORQUE_MAX_NM, strict=True)
    lines = [
        f'<position joint="{name}" kp="{stiffness}" kv="{lag_s * stiffness}" '
        f'forcerange="{-torque} {torque}" forcelimited="true"/>'
        for name, stiffness, torque in rows
    ]
    return '<actuator>' + ''.join(lines) + '</actuator>'


def _words(values: Sequence[float]) -> str:
    return ' '.join(repr(float(v)) for v in values)
