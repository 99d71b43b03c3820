# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Contact of a rounded straight edge with the bonded layer, on a grid of pressures.

No axis of symmetry helps here, so pressure and surface live on a grid and the layer's response is
taken in wave space: u(k) = 2 (1 - nu^2) / (E k) M(k h) p(k), the same layer as in
``layer_contact``. Pressures that do not pull are found by the conjugate gradients of Polonsky and
Keer (1999). Everything is per kPa of modulus and kept per edge and thickness.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.fft import irfft2, rfft2
from scipy.ndimage import map_coordinates

from mixtac_sim.displacement_field import depth_profiles
from mixtac_sim.errors import SimulationError
from mixtac_sim.layer_contact import surface_mobility

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_sim.indenter import Indenter

SHAPE = (240, 96)
"""Grid across and along the edge."""
CELL_MM = (0.1, 0.25)
"""Its cells [mm]: the contact is one or two millimetres wide."""
ROWS = 20
"""Depths that are solved, from 0 on in a quadratic progression."""
DEEPEST = 0.4
"""Largest depth over the thickness; twice the trials' largest force is below it."""
HEIGHTS = np.linspace(0.0, 1.0, 13)
"""Heights above the base over the thickness at which the field is kept."""
ACCURACY = 1e-3
"""Largest error of the surface over the depth at which the search ends."""
SEARCHES = 400
"""Steps after which a search has failed."""


class _Waves(NamedTuple):
    """Wave numbers of the grid.

    Attributes:
        across: Of each row [n, 1] [1/mm].
        along: Of each column [1, m] [1/mm].
        size: Their length [n, m] [1/mm], 1 in place of 0.
        compliance: Surface displacement over pressure [n, m] [mm/kPa at 1 kPa modulus].
    """

    across: NDArray[np.float64]
    along: NDArray[np.float64]
    size: NDArray[np.float64]
    compliance: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class EdgeContact:
    """An edge on a layer at ``ROWS`` depths.

    Attributes:
        thickness_mm: Thickness of the layer [mm].
        depth_mm: Depths [20] [mm].
        force_n: Forces per kPa of modulus [20] [N].
        radius_mm: Radius of the circle as large as the contact [20] [mm].
        spectra: Pressures in wave space per kPa of modulus [20, 240, 49].
    """

    thickness_mm: float
    depth_mm: NDArray[np.float64]
    force_n: NDArray[np.float64]
    radius_mm: NDArray[np.float64]
    spectra: NDArray[np.complex128]

    def displacements(
        self,
        x_mm: NDArray[np.float64],
        y_mm: NDArray[np.float64],
        height: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Return displacements along, across and inwards [20, n, 3] [mm] at points of the layer.

        Args:
            x_mm: Place along the edge, from its middle [n] [mm].
            y_mm: Place across it [n] [mm].
            height: Height above the base over the thickness [n].
        """
        waves = _waves(self.thickness_mm)
        inner, slope = depth_profiles((waves.size * self.thickness_mm).ravel(), HEIGHTS)
        shape = (*waves.size.shape, len(HEIGHTS))
        soft = (1.5 / waves.size)[:, :, None]
        inward, outward = soft * inner.reshape(shape), soft * slope.reshape(shape)
        inward[0, 0] = outward[0, 0] = 0.0
        turn = (-1j / waves.size)[:, :, None] * outward
        modes = (turn * waves.along[:, :, None], turn * waves.across[:, :, None], inward)
        place = np.stack(
            [
                height * (len(HEIGHTS) - 1),
                np.clip(y_mm / CELL_MM[0] + SHAPE[0] // 2, 0, SHAPE[0] - 1),
                np.clip(x_mm / CELL_MM[1] + SHAPE[1] // 2, 0, SHAPE[1] - 1),
            ]
        )
        moved = np.empty((ROWS, len(x_mm), 3))
        for row, spectrum in enumerate(self.spectra):
            for axis, mode in enumerate(modes):
                field = irfft2(np.moveaxis(spectrum[:, :, None] * mode, -1, 0), SHAPE)
                moved[row, :, axis] = map_coordinates(field, place, order=1)
        return moved


@lru_cache(maxsize=8)
def solve_edge(edge: Indenter, thickness_mm: float) -> EdgeContact:
    """Return the contact of an edge with a layer (below 2 s, once per edge and layer).

    Raises:
        SimulationError: The search for the pressures did not end.
    """
    gap, waves = _gap(edge), _waves(thickness_mm)
    depths = DEEPEST * thickness_mm * np.linspace(0.0, 1.0, ROWS) ** 2
    pressure, cell = np.zeros(SHAPE), CELL_MM[0] * CELL_MM[1]
    force, area, spectra = np.zeros(ROWS), np.zeros(ROWS), []
    for row, depth in enumerate(depths):
        if row:
            pressure = _press(pressure, gap - depth, waves.compliance, float(depth))
        force[row] = 1e-3 * cell * pressure.sum()
        area[row] = cell * np.count_nonzero(pressure)
        spectra.append(rfft2(pressure))
    radius = np.sqrt(area / np.pi)
    return EdgeContact(thickness_mm, depths, force, radius, np.stack(spectra))


def _gap(edge: Indenter) -> NDArray[np.float64]:
    """Return how far the edge is from the skin at first touch [240, 96] [mm]."""
    across = CELL_MM[0] * (np.arange(SHAPE[0]) - SHAPE[0] // 2)
    along = CELL_MM[1] * (np.arange(SHAPE[1]) - SHAPE[1] // 2)
    beyond = np.maximum(np.abs(along) - 0.5 * edge.length_mm, 0.0)
    return np.asarray((across[:, None] ** 2 + beyond**2) / (2.0 * edge.radius_mm))


def _waves(thickness_mm: float) -> _Waves:
    across = np.asarray(2.0 * np.pi * np.fft.fftfreq(SHAPE[0], CELL_MM[0])[:, None], np.float64)
    along = np.asarray(2.0 * np.pi * np.fft.rfftfreq(SHAPE[1], CELL_MM[1])[None, :], np.float64)
    size = np.hypot(across, along)
    size[0, 0] = 1.0
    compliance = 1.5 / size * surface_mobility(size * thickness_mm)
    compliance[0, 0] = 0.0
    return _Waves(across, along, size, compliance)


def _press(
    pressure: NDArray[np.float64],
    open_mm: NDArray[np.float64],
    compliance: NDArray[np.float64],
    depth_mm: float,
) -> NDArray[np.float64]:
    """Return the pressures [kPa at 1 kPa modulus] that close the gap without a pull.

    Args:
        pressure: Where to start.
        open_mm: Gap that is left when the skin does not move, negative where it must [mm].
        compliance: Of ``_Waves``.
        depth_mm: Depth [mm].
    """
    pressure = np.where(open_mm < 0.0, np.maximum(pressure, 1e-3), 0.0)
    way, before, kept = np.zeros(SHAPE), 1.0, 0.0
    for _ in range(SEARCHES):
        touching = pressure > 0.0
        gap = irfft2(rfft2(pressure) * compliance, SHAPE) + open_mm
        if np.abs(gap[touching]).max() < ACCURACY * depth_mm and gap.min() > -ACCURACY * depth_mm:
            return pressure
        square = float(np.sum(gap[touching] ** 2))
        way = np.where(touching, gap + kept * square / before * way, 0.0)
        before = square
        bent = irfft2(rfft2(way) * compliance, SHAPE)
        step = float(np.sum(gap[touching] * way[touching]) / np.sum(bent[touching] * way[touching]))
        pressure = np.where(touching, np.maximum(pressure - step * way, 0.0), 0.0)
        inside = (pressure == 0.0) & (gap < 0.0)
        kept = 0.0 if inside.any() else 1.0
        pressure[inside] -= step * gap[inside]
    msg = f'no pressures found for an edge at {depth_mm:.2f} mm; choose a rounder or shorter one'
    raise SimulationError(msg)
