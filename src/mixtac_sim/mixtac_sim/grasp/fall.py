# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Motion of the held object: weight and blow against the skin's pull and the wall's friction."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from mixtac_sim.contact_steps import STEP_US
from mixtac_sim.grasp.skin import slide

if TYPE_CHECKING:
    from numpy.typing import NDArray

SUBSTEPS = 8
"""Steps per grid step of 125 us while the object moves; a step at rest is one."""


@njit(cache=True, nogil=True, error_model='numpy')
def fall(
    body: NDArray[np.float64],
    constants: tuple[float, float, float, float, float, float, float],
    skin: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]],
    gel: tuple[NDArray[np.float64], NDArray[np.float64]],
    surface: NDArray[np.float64],
    law: tuple[float, float, float, float, float, float],
    normal_n: NDArray[np.float64],
    path: NDArray[np.float64],
    patches: NDArray[np.float64],
) -> None:
    """Advance the object over some grid steps.

    Args:
        body: Time [s], place [mm] and speed [mm/s] of the object, downwards; changed.
        constants: Mass [kg], weight [N], static and kinetic friction of the wall, start [s],
            length [s] and speed [mm/s] of the blow.
        skin: State of the patches, as in ``slide``; changed.
        gel: As in ``slide``.
        surface: As in ``slide``.
        law: As in ``slide``.
        normal_n: Normal force over each grid step [n] [N].
        path: Place [mm], speed [mm/s] and pull of the skin [N] at the end of each step [n, 3].
        patches: Shear of the patches at the end of each step [n, patch] [mm].
    """
    mass, weight, static, kinetic, knock_s, pulse_s, knock_mm_s = constants
    grid_s = 1e-6 * STEP_US
    for k in range(normal_n.size):
        pull = 0.0
        blown = knock_s - grid_s <= body[0] <= knock_s + pulse_s
        parts = SUBSTEPS if blown or body[2] != 0.0 else 1
        step = grid_s / parts
        for _ in range(parts):
            body[0] += step
            pull = slide(skin, gel, surface, law, normal_n[k], body[2], step)
            since = (body[0] - knock_s) / pulse_s
            blow = 0.0
            if 0.0 < since < 1.0:
                blow = 1e-3 * mass * knock_mm_s * 0.5 * np.pi / pulse_s * np.sin(np.pi * since)
            net = weight + blow - pull
            if body[2] == 0.0 and abs(net) <= static * normal_n[k]:
                continue
            way = np.sign(body[2]) if body[2] != 0.0 else np.sign(net)
            speed = body[2] + 1e3 * step * (net - way * kinetic * normal_n[k]) / mass
            # Dry friction stops a body, it never turns it around.
            body[2] = 0.0 if speed * way < 0.0 else speed
            body[1] += step * body[2]
        path[k, 0], path[k, 1], path[k, 2] = body[1], body[2], pull
        patches[k] = skin[0]
