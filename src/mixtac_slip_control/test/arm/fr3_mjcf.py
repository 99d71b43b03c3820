# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A mesh-free FR3 for MuJoCo, for the simulated control unit of the tests.

Link masses are Franka's; inertias are those of balls of 6 cm, for want of published ones.
"""

from __future__ import annotations

import math

MASSES = (2.397, 2.927, 2.936, 2.245, 2.616, 2.327, 1.817, 0.627)
A = (0.0, 0.0, 0.0, 0.0825, -0.0825, 0.0, 0.088)
D = (0.333, 0.0, 0.316, 0.0, 0.384, 0.0, 0.0)
ALPHA = (0.0, -1.0, 1.0, 1.0, -1.0, 1.0, 1.0)
RANGES = (
    (-2.7437, 2.7437),
    (-1.7837, 1.7837),
    (-2.9007, 2.9007),
    (-3.0421, -0.1518),
    (-2.8065, 2.8065),
    (0.5445, 4.5169),
    (-3.0159, 3.0159),
)


def fr3_mjcf() -> str:
    """Return the model."""
    lines = [
        '<mujoco model="fr3"><compiler angle="radian"/><worldbody>',
        _body(0, '0 0 0', '1 0 0 0'),
    ]
    lines.append('</body>' * 8)
    lines.append('</worldbody></mujoco>')
    return '\n'.join(lines)


def _body(k: int, place: str, turn: str) -> str:
    mass = MASSES[k]
    inertia = 0.4 * mass * 0.06**2
    text = (
        f'<body name="fr3_link{k}" pos="{place}" quat="{turn}">'
        f'<inertial pos="0 0 0" mass="{mass}" diaginertia="{inertia} {inertia} {inertia}"/>'
    )
    if k > 0:
        low, high = RANGES[k - 1]
        text += (
            f'<joint name="fr3_joint{k}" axis="0 0 1" range="{low} {high}" limited="true" '
            'damping="1" armature="0.1"/>'
        )
    if k == 7:
        return text
    half = math.pi / 4 * ALPHA[k]
    c, s = math.cos(math.pi / 2 * ALPHA[k]), math.sin(math.pi / 2 * ALPHA[k])
    place = f'{A[k]} {-s * D[k]} {c * D[k]}'
    return text + _body(k + 1, place, f'{math.cos(half)} {math.sin(half)} 0 0')
