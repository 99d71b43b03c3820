# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Glass beads at random places and depths of the transparent layer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mixtac_sim.presets import EASY
from mixtac_sim.random_streams import stream

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_sim.effects import OpticsEffects

DIAMETER_MM = 0.8
"""Diameter of the beads [mm] (paper, section 3.1)."""
EXTENT_MM = (17.0, 13.0)
"""Half width and height [mm] of the patch with beads, a little beyond the view."""


@dataclass(frozen=True, slots=True)
class Markers:
    """Beads at rest; x and y count from the optical axis, depth from the skin.

    Attributes:
        x_mm: Place to the right in the image [n] [mm].
        y_mm: Place downwards in the image [n] [mm].
        depth_mm: Depth of the centre below the skin [n] [mm].
        opacity: How strongly each bead covers what is behind it [n].
    """

    x_mm: NDArray[np.float64]
    y_mm: NDArray[np.float64]
    depth_mm: NDArray[np.float64]
    opacity: NDArray[np.float64]


def scatter_markers(
    device_seed: int, thickness_mm: float, optics: OpticsEffects = EASY.optics
) -> Markers:
    """Return the beads of a device: uniform in the layer, none inside another.

    Args:
        device_seed: Seed of the device.
        thickness_mm: Thickness of the layer [mm].
        optics: Number of beads (estimate: 450 are about 5 % of the volume), and how far apart
            they are for the lens.
    """
    few, many = optics.beads
    beads = int(stream(device_seed, 'number of markers').integers(few, many + 1))
    rng = stream(device_seed, 'markers')
    margin = 0.5 * DIAMETER_MM + 0.1
    low = np.array([-EXTENT_MM[0], -EXTENT_MM[1], margin])
    high = np.array([EXTENT_MM[0], EXTENT_MM[1], thickness_mm - margin])
    placed = np.empty((beads, 3))
    count = 0
    while count < beads:
        spot = rng.uniform(low, high)
        square = (placed[:count] - spot) ** 2
        apart, aside = np.sum(square, axis=1), np.sum(square[:, :2], axis=1)
        if count == 0 or (apart.min() > DIAMETER_MM**2 and aside.min() >= optics.apart_mm**2):
            placed[count] = spot
            count += 1
    opacity = rng.uniform(1.2, 3.0, size=beads)
    return Markers(placed[:, 0], placed[:, 1], placed[:, 2], opacity)
