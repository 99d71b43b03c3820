# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The steel mesh seen from the camera as it sags under load: its wires move and hide other beads.

The light on the array is tabulated over the sag and blended between the tables, as the wires move
by less than their blur from one table to the next.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mixtac_sim.array_geometry import TILE, TILES
from mixtac_sim.bead_motion import SAG_MM
from mixtac_sim.scene import build_sagging

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_sim.device import DeviceModel
    from mixtac_sim.dvs import Dvs

LEVELS_MM = np.linspace(0.0, 0.6, 13)
"""Sags of the tables [mm]; 0.6 mm are 1 to 6 N. A mesh that sags more is shown like that."""
TOLERANCE_MM = 0.008
"""Motion below this is not shown: it changes no log intensity by more than 2 %."""
VISIBLE = 0.02
"""Relative change of the light below which a tile is left alone."""


class MeshMotion:
    """Moves the mesh in the light of the pixels.

    Args:
        device: The sensor.
        contact_mm: Where it is pressed, from the optical axis [mm].
    """

    def __init__(self, device: DeviceModel, contact_mm: tuple[float, float]) -> None:
        scenes = build_sagging(device.lens, device.lighting, contact_mm, LEVELS_MM, SAG_MM)
        self._floor = np.stack([scene.floor.reshape(TILES, TILE) for scene in scenes])
        self._gain = np.stack([scene.gain.reshape(TILES, TILE) for scene in scenes])
        change = np.abs(self._floor[-1] / self._floor[0] - 1.0).max(axis=1)
        self._tiles: NDArray[np.int64] = np.flatnonzero(change > VISIBLE).astype(np.int64)
        self._per_n = 1.0 / device.mesh_n_per_mm
        self._shown_mm = 0.0

    def show(self, dvs: Dvs, dirty: NDArray[np.uint8], elastic_n: float) -> None:
        """Let the pixels see the mesh under an elastic force [N]; tiles that change get dirty."""
        sag = min(elastic_n * self._per_n, float(LEVELS_MM[-1]))
        if abs(sag - self._shown_mm) < TOLERANCE_MM:
            return
        self._shown_mm = sag
        place = sag / float(LEVELS_MM[1])
        dvs.blend(self._floor, self._gain, self._tiles, place)
        dirty[self._tiles] = 1
