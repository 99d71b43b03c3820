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

from mixtac_sim.array_geometry import PADDED, TILES
from mixtac_sim.dvs_kernels import PixelState, develop, light_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_sim.pixels import PixelSettings, PixelSpread
    from mixtac_sim.scene import Scene

CAPACITY = 1 << 20
"""Threshold crossings kept per block; a readout passes 48 000 in 4 ms."""


class Dvs:
    """All DVS pixels of a chip.

    Args:
        scene: Light on the array.
        spread: Differences between pixels.
        settings: Settings of this chip.
        rng: Draws where each pixel stands between its thresholds at the start.

    Attributes:
        lost: Crossings beyond ``CAPACITY``.
    """

    def __init__(
        self,
        scene: Scene,
        spread: PixelSpread,
        settings: PixelSettings,
        rng: np.random.Generator,
    ) -> None:
        self._scene = scene
        self._spread = spread
        self._state = _blank_state()
        self._keys = np.empty(CAPACITY, np.int64)
        self._count = np.zeros(2, np.int64)
        self.configure(settings)
        self._begin(rng)

    @property
    def light(self) -> NDArray[np.float32]:
        """Return the present light on the array [padded pixels] [lx]."""
        return self._state.light

    @property
    def lost(self) -> int:
        """Return how many crossings did not fit."""
        return int(self._count[1])

    def configure(self, settings: PixelSettings) -> None:
        """Change the settings from the next step on."""
        self._settings = settings
        state, spread = self._state, self._spread
        state.on[:] = settings.threshold_on * spread.on
        state.off[:] = settings.threshold_off * spread.off
        rate = settings.leak_hz + settings.leak_hz_per_lux * self._scene.floor
        state.leak[:] = rate * spread.leak * settings.threshold_on
        state.active[:] = 1

    def _begin(self, rng: np.random.Generator) -> None:
        """Settle on the scene at rest, with every pixel somewhere on its way to a leak event."""
        state = self._state
        state.light[:] = self._scene.floor
        state.log[:] = np.log(state.light)
        state.follow[:] = state.log
        state.difference[:] = state.on * rng.random(PADDED, np.float32) * np.float32(0.999)

    def settle(self, cover: NDArray[np.int32]) -> None:
        """Take the light under a cover as the resting light, without events."""
        state = self._state
        state.light[:] = light_of(self._scene.floor, self._scene.gain, cover)
        state.log[:] = np.log(state.light)
        state.follow[:] = state.log

    def step(
        self,
        cover: NDArray[np.int32],
        dirty: NDArray[np.uint8],
        start_ns: int,
        end_ns: int,
        block_ns: int,
    ) -> None:
        """Advance over one step in which the light moves to what the cover now gives.

        Args:
            cover: Of ``Renderer``.
            dirty: Tiles whose cover changed; cleared.
            start_ns: Begin of the step [ns] of true time.
            end_ns: End of the step [ns].
            block_ns: Begin of the block of steps [ns], which crossings count from.
        """
        settings = self._settings
        corners = (settings.source_follower_hz, settings.hz_per_lux)
        refractory_ns = int(1e3 * settings.refractory_us)
        develop(
            self._state,
            self._scene.floor,
            self._scene.gain,
            cover,
            dirty,
            corners,
            refractory_ns,
            start_ns,
            end_ns,
            block_ns,
            self._keys,
            self._count,
        )

    def take(self) -> NDArray[np.int64]:
        """Return the crossings since the last call, unsorted, packed as in ``readout``."""
        taken = self._keys[: self._count[0]].copy()
        self._count[0] = 0
        return taken


def _blank_state() -> PixelState:
    """Return arrays of the right sizes."""
    light = np.ones(PADDED, np.float32)
    return PixelState(
        light=light,
        light_bits=light.view(np.int32),
        log=np.zeros(PADDED, np.float32),
        follow=np.zeros(PADDED, np.float32),
        difference=np.zeros(PADDED, np.float32),
        on=np.ones(PADDED, np.float32),
        off=np.ones(PADDED, np.float32),
        leak=np.zeros(PADDED, np.float32),
        ready_ns=np.zeros(PADDED, np.int64),
        last_ns=np.zeros(TILES, np.int64),
        due_ns=np.zeros(TILES, np.int64),
        active=np.ones(TILES, np.uint8),
    )
