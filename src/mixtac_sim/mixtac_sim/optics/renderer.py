# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Draws what moves: the discs of the beads, and the mesh that sags under load.

Beads are blurred discs in a sum kept in fixed point, so removing a disc restores every bit of what
was there before: only beads that moved are redrawn, and no error grows. The pixels
(`mixtac_sim.pixels.dvs`) compute how the sum covers the background.

The light of the mesh is tabulated over its sag and blended between the tables, as its wires move by
less than their blur from one table to the next.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mixtac_core.events.arrays import Floats
from mixtac_sim.grids import HEIGHT, PADDED, TILE, TILES, WIDTH
from mixtac_sim.optics.beads import SAG_MM
from mixtac_sim.optics.scene import Lens, Lighting, build_sagging

ONE = 65536
"""Fixed-point one of the sum."""
TOLERANCE_PX = 0.01
"""Motion or growth below this is not drawn: it changes no log intensity by more than 1 %."""


class Renderer:
    """The sum of all bead images.

    Args:
        opacity: Optical thickness of each bead [n].

    Attributes:
        cover: Optical thickness times ``ONE`` [padded pixels], int32.
        dirty: Tiles in which ``cover`` changed since they were last cleared [tiles], uint8.
    """

    def __init__(self, opacity: Floats) -> None:
        self.cover = np.zeros(PADDED, np.int32)
        self.dirty = np.ones(TILES, np.uint8)
        self._opacity = opacity
        self._drawn = np.zeros((len(opacity), 4))  # radius 0: nothing is there yet

    def draw(self, spots: Floats) -> None:
        """Show beads at new places.

        Args:
            spots: Column, row, radius and edge width of each bead [n, 4] [px].
        """
        _redraw(self.cover, self.dirty, self._drawn, spots, self._opacity)


@njit(cache=True, nogil=True, error_model='numpy')
def _redraw(
    cover: NDArray[np.int32],
    dirty: NDArray[np.uint8],
    drawn: Floats,
    spots: Floats,
    opacity: Floats,
) -> None:
    """Remove and redraw the discs that moved."""
    for i in range(spots.shape[0]):
        moved = abs(spots[i, 0] - drawn[i, 0]) + abs(spots[i, 1] - drawn[i, 1])
        grown = abs(spots[i, 2] - drawn[i, 2]) + 0.5 * abs(spots[i, 3] - drawn[i, 3])
        if moved + grown < TOLERANCE_PX:
            continue
        if drawn[i, 2] > 0.0:
            _splat(cover, dirty, drawn[i], -opacity[i] * ONE)
        _splat(cover, dirty, spots[i], opacity[i] * ONE)
        for k in range(spots.shape[1]):
            drawn[i, k] = spots[i, k]


@njit(cache=True, nogil=True, error_model='numpy')
def _splat(cover: NDArray[np.int32], dirty: NDArray[np.uint8], spot: Floats, height: float) -> None:
    """Add one disc with a smooth edge, darker towards its limb as a lit ball is."""
    x, y = np.float32(spot[0]), np.float32(spot[1])
    outer = np.float32(spot[2] + 0.5 * spot[3])
    per_width, per_radius = np.float32(1.0 / spot[3]), np.float32(0.25 / spot[2] ** 2)
    peak = np.float32(height)
    first_row, last_row = max(int(np.ceil(y - outer)), 0), min(int(y + outer), HEIGHT - 1)
    left, right = max(int(np.ceil(x - outer)), 0), min(int(x + outer), WIDTH - 1)
    if first_row > last_row or left > right:
        return
    for row in range(first_row, last_row + 1):
        base = row * WIDTH
        dy = (row - y) * (row - y)
        for column in range(left, right + 1):
            square = (column - x) * (column - x) + dy
            ramp = (outer - np.sqrt(square)) * per_width
            ramp = min(max(ramp, np.float32(0.0)), np.float32(1.0))
            edge = ramp * ramp * (np.float32(3.0) - np.float32(2.0) * ramp)
            limb = max(np.float32(1.0) - per_radius * square, np.float32(0.4))
            cover[base + column] += np.int32(peak * edge * limb)
        for tile in range((base + left) // TILE, (base + right) // TILE + 1):
            dirty[tile] = 1


LEVELS_MM = np.linspace(0.0, 0.6, 13)
"""Sags of the tables [mm]; 0.6 mm are 1 to 6 N. A mesh that sags more is shown like that."""
TOLERANCE_MM = 0.002
"""Motion below this is not shown: it changes no log intensity by more than 0.5 %."""
VISIBLE = 0.02
"""Relative change of the light below which a tile is left alone."""


class MeshMotion:
    """Light on the array behind a mesh that sags.

    Args:
        lens: The lens.
        lighting: Light and mesh.
        mesh_n_per_mm: Stiffness of the mesh [N/mm].
        contact_mm: Where it is pressed, from the optical axis [mm].

    Attributes:
        floors: Light without beads at each of `LEVELS_MM` [level, tile, 64] [lx].
        gains: Change from no bead to bead [level, tile, 64] [lx].
        tiles: Tiles in which the mesh can be seen to move [n].
    """

    def __init__(
        self,
        lens: Lens,
        lighting: Lighting,
        mesh_n_per_mm: float,
        contact_mm: tuple[float, float],
    ) -> None:
        scenes = build_sagging(lens, lighting, contact_mm, LEVELS_MM, SAG_MM)
        self.floors = np.stack([scene.floor.reshape(TILES, TILE) for scene in scenes])
        self.gains = np.stack([scene.gain.reshape(TILES, TILE) for scene in scenes])
        change = np.abs(self.floors[-1] / self.floors[0] - 1.0).max(axis=1)
        self.tiles: NDArray[np.int64] = np.flatnonzero(change > VISIBLE).astype(np.int64)
        self._per_n = 1.0 / mesh_n_per_mm
        self._shown_mm = 0.0

    def level(self, elastic_n: float) -> float | None:
        """Return the place among the levels under an elastic force [N], None if as shown before."""
        sag = min(elastic_n * self._per_n, float(LEVELS_MM[-1]))
        if abs(sag - self._shown_mm) < TOLERANCE_MM:
            return None
        self._shown_mm = sag
        return sag / float(LEVELS_MM[1])
