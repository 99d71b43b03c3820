# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The DVS pixels: light to logarithm, first-order bandwidth, thresholds, refractory time, leak.

Every pixel follows the logarithm of its light with a corner that grows with the light up to the
source follower's; its difference to the value at the last event is compared with two thresholds,
while leak lets it rise slowly. Within a step light and difference are straight lines, the step of
the low-pass is exact for that, and events lie where the line meets a threshold. Tiles in which
nothing happens are skipped until their first leak event is due.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mixtac_sim.array_geometry import PADDED, PIXELS, TILE, TILES
from mixtac_sim.dvs_kernels import (
    DIFFERENCE,
    FLOOR,
    FOLLOW,
    GAIN,
    LEAK,
    LIGHT,
    LOG,
    OFF,
    ON,
    ROWS,
    Corners,
    Crossings,
    PixelState,
    Ripple,
    blend,
    develop,
    relight,
)
from mixtac_sim.flicker import Flicker

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_sim.pixels import PixelSettings, PixelSpread
    from mixtac_sim.scene import Scene

CAPACITY = 1 << 20
"""Threshold crossings kept per block; a readout passes 50 000 in 4 ms."""

BEYOND = 1e9
"""A threshold that no difference of logarithms reaches."""


class Dvs:
    """All DVS pixels of a chip.

    Args:
        scene: Light on the array.
        spread: Differences between pixels.
        settings: Settings of this chip.
        rng: Draws where each pixel stands between its thresholds at the start.
    """

    def __init__(
        self,
        scene: Scene,
        spread: PixelSpread,
        settings: PixelSettings,
        rng: np.random.Generator,
    ) -> None:
        self._spread = spread
        self._state = _blank_state()
        self._row(FLOOR)[:] = _tiled(scene.floor)
        self._row(GAIN)[:] = _tiled(scene.gain)
        self.light_by(Flicker(0.0, 0.0, 0.0))
        self._crossings = Crossings(np.empty(CAPACITY, np.int64), np.zeros(2, np.int64))
        self.configure(settings)
        # Every pixel is somewhere on its way to its next leak event.
        self._row(DIFFERENCE)[:] = self._row(ON) * rng.random((TILES, TILE), np.float32)
        self.settle(np.zeros(PADDED, np.int32))

    def _row(self, row: int) -> NDArray[np.float32]:
        """Return one value of all pixels [tiles, 64], as a view."""
        return self._state.values[:, row]

    @property
    def light(self) -> NDArray[np.float32]:
        """Return the present light on the array [tiles, 64] [lx], as a view."""
        return self._row(LIGHT)

    @property
    def lost(self) -> int:
        r"""Return how many crossings did not fit into \`\`CAPACITY\`\`."""
        return int(self._crossings.tally[1])

    def configure(self, settings: PixelSettings) -> None:
        """Change the settings from the next step on."""
        self._corners = Corners(
            settings.source_follower_hz, settings.hz_per_lux, int(1e3 * settings.refractory_us)
        )
        spread = self._spread
        self._row(ON)[:] = _tiled(settings.threshold_on * spread.on)
        self._row(OFF)[:] = _tiled(settings.threshold_off * spread.off)
        rate = settings.leak_hz + settings.leak_hz_per_lux * self._row(FLOOR)
        self._row(LEAK)[:] = rate * _tiled(spread.leak) * self._row(ON)
        # The last tile is longer than the array: what lies beyond must never fire.
        for row, value in ((ON, BEYOND), (OFF, BEYOND), (LEAK, 0.0)):
            self._row(row)[-1, PIXELS - PADDED :] = value
        self._state.active[:] = 1

    def light_by(self, flicker: Flicker) -> None:
        """Let the lamp flicker; steady before the first call."""
        self._flicker = flicker
        self._resolved = not (flicker.steady or flicker.small)
        depth = 0.0 if flicker.steady or self._resolved else flicker.depth
        self._ripple = Ripple(depth, flicker.hz, 2.0 * np.pi * flicker.phase, 0)

    def settle(self, cover: NDArray[np.int32]) -> None:
        r"""Take the light under a cover as one that has been there for long.

        Args:
            cover: Of \`\`Renderer\`\` [padded pixels].
        """
        state = self._state
        for tile in range(TILES):
            covered = cover[tile * TILE : (tile + 1) * TILE]
            relight(state.values[tile], state.bits[tile], covered)
        self._row(FOLLOW)[:] = self._row(LOG)

    def step(
        self,
        cover: NDArray[np.int32],
        dirty: NDArray[np.uint8],
        start_ns: int,
        end_ns: int,
        block_ns: int,
    ) -> None:
        r"""Advance over one step in which the light moves to what the cover now gives.

        Args:
            cover: Of \`\`Renderer\`\`.
            dirty: Tiles whose cover changed; cleared.
            start_ns: Begin of the step [ns] of true time.
            end_ns: End of the step [ns].
            block_ns: Begin of the block of steps [ns], which crossings count from.
        """
        lamp, glow = self._flicker, (0.0, 0.0)
        if self._resolved:
            glow = lamp.log_light(1e-3 * start_ns), lamp.log_light(1e-3 * end_ns)
        develop(
            self._state,
            cover,
            dirty,
            self._corners,
            glow,
            self._resolved,
            self._ripple._replace(now_ns=end_ns) if self._ripple.depth else self._ripple,
            start_ns,
            end_ns,
            block_ns,
            self._crossings,
        )

    def blend(
        self,
        floors: NDArray[np.float32],
        gains: NDArray[np.float32],
        tiles: NDArray[np.int64],
        place: float,
    ) -> None:
        r"""Move the light of some tiles to a place in a series of scenes; they are dirty then.

        Args:
            floors: Light without beads [scene, tile, 64] [lx].
            gains: Change from no bead to bead [scene, tile, 64] [lx].
            tiles: Tiles that change [n].
            place: Number of the scene; between two, a blend of them.
        """
        blend(self._state.values, floors, gains, tiles, place)

    def take(self) -> NDArray[np.int64]:
        r"""Return the crossings since the last call, unsorted, packed as in \`\`readout\`\`."""
        keys, tally = self._crossings
        taken = keys[: tally[0]].copy()
        tally[0] = 0
        return taken


def _tiled(pixels: NDArray[np.float32]) -> NDArray[np.float32]:
    return pixels.reshape(TILES, TILE)


def _blank_state() -> PixelState:
    """Return arrays of the right sizes."""
    values = np.zeros((TILES, ROWS, TILE), np.float32)
    return PixelState(
        values=values,
        bits=values.view(np.int32),
        ready_ns=np.zeros(PADDED, np.int64),
        last_ns=np.zeros(TILES, np.int64),
        due_ns=np.zeros(TILES, np.int64),
        active=np.ones(TILES, np.uint8),
    )
