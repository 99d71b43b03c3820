# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Shear of the skin under an indenter that comes in a little off the normal."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_sim.elastomer import Layer


LIGHT_N = 0.05
"""Friction does not grow further below this force [N] (estimate)."""


class Shear:
    """Shear displacement and force, limited by friction.

    The loaded patch, widened by half the thickness, is a block in simple shear (estimate). With
    partial slip the pull follows Cattaneo's and Mindlin's law of a sphere: it starts with the
    same stiffness and slides as a whole at 1.5 times the displacement.

    Args:
        layer: The sensing layer.
        friction: Coefficient of friction at 1 N.
        lean: Shear displacement per depth, to the right and downwards.
        friction_load: Friction falls as the force to the power of minus this.
        partial_slip: Whether the rim of the contact slips before the whole does.
    """

    def __init__(
        self,
        layer: Layer,
        friction: float,
        lean: tuple[float, float],
        friction_load: float = 0.0,
        *,
        partial_slip: bool = False,
    ) -> None:
        self._modulus = 1e-3 * layer.modulus_kpa / 3.0
        self._thickness = layer.thickness_mm
        self._friction = friction
        self._friction_load = friction_load
        self._partial_slip = partial_slip
        self._lean = np.array(lean)

    def at(
        self,
        force_n: NDArray[np.float64],
        depth_mm: NDArray[np.float64],
        radius_mm: NDArray[np.float64],
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return displacement [n, 2] [mm] and force [n, 2] [N], right and down."""
        area = np.pi * (radius_mm + 0.5 * self._thickness) ** 2
        stiffness = self._modulus * area / self._thickness
        wanted = depth_mm[:, None] * self._lean
        pull = stiffness[:, None] * wanted
        size = np.maximum(np.hypot(pull[:, 0], pull[:, 1]), 1e-12)
        limit = self._limit(force_n)
        if self._partial_slip:
            slid = 1.0 - np.minimum(size / np.maximum(1.5 * limit, 1e-12), 1.0)
            share = (limit * (1.0 - slid**1.5) / size)[:, None]
        else:
            share = np.minimum(1.0, limit / size)[:, None]
        return share * wanted, share * pull

    def _limit(self, force_n: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the largest pull that friction bears [N]."""
        if self._friction_load == 0.0:
            return self._friction * force_n
        load = np.maximum(force_n, LIGHT_N) ** -self._friction_load
        return np.asarray(self._friction * load * force_n)
