# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Shear of the skin under an indenter that comes in a little off the normal."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_sim.elastomer import Layer


class Shear:
    """Shear displacement and force, limited by friction.

    The loaded patch, widened by half the thickness, is a block in simple shear (estimate).

    Args:
        layer: The sensing layer.
        friction: Coefficient of friction.
        lean: Shear displacement per depth, to the right and downwards.
    """

    def __init__(self, layer: Layer, friction: float, lean: tuple[float, float]) -> None:
        self._modulus = 1e-3 * layer.modulus_kpa / 3.0
        self._thickness = layer.thickness_mm
        self._friction = friction
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
        share = np.minimum(1.0, self._friction * force_n / size)[:, None]
        return share * wanted, share * pull
