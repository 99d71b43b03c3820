# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Where the beads are while patches of the skin shear."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mixtac_sim.contact_steps import STEP_US
from mixtac_sim.grasp.skin import wave_speed_mm_s

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_sim.device import DeviceModel
    from mixtac_sim.elastomer import Layer

REACH = 0.6
"""Distance over which shear decays outside the contact, in thicknesses (as in ``Shear``)."""
SMALLEST_MM = 1.0
"""Smallest width of the part of the gel that one patch moves [mm]."""


class SkinBeads:
    """Turns the displacement of patches into that of beads.

    A bead follows the patches above it in proportion to its height over the mesh, later by what a
    shear wave takes from the skin to it; reflections are not modelled.

    Args:
        device: The sensor.
        layer: Its layer on the day.
        contact_mm: Centre of the contact from the optical axis [mm].
        places_mm: Centres of the patches from the contact's [patch, 2] [mm].
        radius_mm: Contact radius [mm].
    """

    def __init__(
        self,
        device: DeviceModel,
        layer: Layer,
        contact_mm: tuple[float, float],
        places_mm: NDArray[np.float64],
        radius_mm: float,
    ) -> None:
        beads = device.markers
        at = np.stack([beads.x_mm, beads.y_mm], axis=1) - np.array(contact_mm)
        width = max(0.35 * radius_mm, 0.5 * layer.thickness_mm, SMALLEST_MM)
        distance = np.linalg.norm(at[:, None] - places_mm, axis=2)
        near = np.exp(-0.5 * (distance / width) ** 2) + 1e-12
        outside = np.maximum(np.hypot(*at.T) - radius_mm, 0.0) / (REACH * layer.thickness_mm)
        height = 1.0 - beads.depth_mm / layer.thickness_mm
        share = near / near.sum(axis=1, keepdims=True)
        self._weights = share * (height * np.exp(-(outside**2)))[:, None]
        late = np.rint(beads.depth_mm / wave_speed_mm_s(layer) * 1e6 / STEP_US).astype(np.int64)
        self._late = np.maximum(late, 0)
        self._past = np.zeros((int(self._late.max()) + 1, len(places_mm)))
        self._rows = [np.flatnonzero(self._late == k) for k in range(len(self._past))]
        self.amount_mm = np.zeros(len(height))

    def settle(self, patches_mm: NDArray[np.float64]) -> None:
        """Take displacements of the patches [patch] [mm] as having been there for long."""
        self._past[:] = patches_mm

    def push(self, patches_mm: NDArray[np.float64]) -> None:
        """Go on by one grid step to displacements of the patches [patch] [mm]."""
        self._past[1:] = self._past[:-1]
        self._past[0] = patches_mm

    def amounts(self) -> NDArray[np.float64]:
        """Return the shear displacement of each bead now [n] [mm]; reused by the next call."""
        for past, rows in zip(self._past, self._rows, strict=True):
            self.amount_mm[rows] = self._weights[rows] @ past
        return self.amount_mm
