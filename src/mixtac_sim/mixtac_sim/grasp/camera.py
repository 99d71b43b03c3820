# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The sensor's optics and pixels over a skin that sticks and slips, in blocks of any length.

The same lens, beads, renderer, pixels, noise, readout and frames as of ``TactileSensor``; only what
moves the beads is different, and blocks may be as short as 1 ms, so that an arm can answer within
the next one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from mixtac_sim.grids import PIXELS, STEP_US, cut_block
from mixtac_sim.optics.renderer import MeshMotion, Renderer
from mixtac_sim.optics.scene import build_scene, draw_flicker
from mixtac_sim.pixels.aps import Aps, ApsFrame, ApsSettings
from mixtac_sim.pixels.biases import PixelSettings
from mixtac_sim.pixels.dvs import Dvs
from mixtac_sim.pixels.noise import NoiseSource, Readout
from mixtac_sim.random_streams import BlockStreams, stream

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_events.arrays import Events
    from mixtac_sim.grasp.skin import SkinBeads
    from mixtac_sim.optics.beads import BeadMotion
    from mixtac_sim.optics.scene import Flicker
    from mixtac_sim.world.device import Conditions, DeviceModel
    from mixtac_sim.world.effects import Preset


@dataclass(frozen=True, slots=True, eq=False)
class SkinBlock:
    """What the skin did over a block; entry k is the state at the end of grid step k (125 us).

    Attributes:
        elastic_n: Elastic part of the normal force [n] [N].
        patches_mm: Shear displacement of the patches [n, patch] [mm].
    """

    elastic_n: NDArray[np.float64]
    patches_mm: NDArray[np.float64]


def on_day(device: DeviceModel, conditions: Conditions) -> DeviceModel:
    """Return a device with its camera where it is on the day of the trial."""
    lens = conditions.lens(device.lens)
    return replace(device, lens=lens, scene=build_scene(lens, device.lighting))


class SkinCamera:
    """Pixels and frames of a sensor whose skin is moved by someone else.

    Args:
        device: The sensor, on the day of the trial.
        conditions: Of the trial.
        preset: How hard the sensor is.
        seed: Seed of the trial.
        beads: Where beads are under a normal force.
        skin_beads: How they follow the skin.
        direction: Of the pull on the skin in the image, right and down, of length 1.
        start: State of the skin at time 0, one step long.
        aps: When frames are taken.
        flicker: Of the lamps; drawn from the preset if None.
    """

    def __init__(
        self,
        device: DeviceModel,
        conditions: Conditions,
        preset: Preset,
        seed: int,
        beads: BeadMotion,
        skin_beads: SkinBeads,
        direction: tuple[float, float],
        start: SkinBlock,
        aps: ApsSettings | None = None,
        flicker: Flicker | None = None,
    ) -> None:
        self._conditions = conditions
        self._beads, self._skin, self._direction = beads, skin_beads, direction
        self._renderer = Renderer(device.markers.opacity)
        exposure = ApsSettings(exposure_us=round(7_000 * conditions.exposure))
        self._aps = Aps(device.seed, seed, device.dn_per_lux_ms, aps or exposure)
        self._mesh = MeshMotion(device, conditions.contact_mm) if preset.optics.mesh_moves else None
        self._build_pixels(device, seed, start)
        self._flicker = draw_flicker(seed, preset.light) if flicker is None else flicker
        self._dvs.light_by(self._flicker)
        speed = preset.bandwidth
        self._readout = Readout(speed.service_ns, speed.latency_ns, speed.jitter_ns)
        self._latency = BlockStreams(seed, 'event latency')
        self._block, self._now_us = 0, 0

    def _build_pixels(self, device: DeviceModel, seed: int, start: SkinBlock) -> None:
        """Let the pixels settle on the state at the start."""
        settings = device.pixel_settings(PixelSettings())
        self._dvs = Dvs(device.scene, device.spread, settings, stream(seed, 'pixel state'))
        self._skin.settle(start.patches_mm[-1])
        self._last = start
        elastic = float(start.elastic_n[-1])
        self._draw(elastic)
        if self._mesh is not None:
            self._mesh.show(self._dvs, self._renderer.dirty, elastic)
        self._dvs.settle(self._renderer.cover)
        self._device, self._seed = device, seed
        self._rest_light = self._dvs.light.ravel()[:PIXELS].copy()
        self._noise = self._noise_source(settings)

    def _noise_source(self, settings: PixelSettings) -> NoiseSource:
        device = self._device
        return NoiseSource(
            self._rest_light, settings, device.spread, device.frame_burst, self._seed
        )

    def configure_pixels(self, nominal: PixelSettings) -> None:
        """Change the DVS settings from the next block on, as new biases would."""
        settings = self._device.pixel_settings(nominal)
        self._dvs.configure(settings)
        self._noise = self._noise_source(settings)

    def configure_aps(self, settings: ApsSettings) -> None:
        """Change the frame settings from the next exposure that has not begun."""
        self._aps.configure(settings)

    @property
    def now_us(self) -> int:
        """Return the time up to which it has been advanced [us] of true time."""
        return self._now_us

    @property
    def lost(self) -> int:
        """Return how many events pixels and readout had to drop so far."""
        return self._dvs.lost + self._readout.lost

    def advance(self, block: SkinBlock) -> tuple[Events, list[ApsFrame]]:
        """Return the events and the frames that ended while the skin did what the block says.

        Events that are still in the readout's queue at the end come with the next block. Times are
        true time [us] since the start.
        """
        steps = len(block.elastic_n)
        start_us, span_ns = self._now_us, 1000 * steps * STEP_US
        end_us = start_us + steps * STEP_US
        bursts = self._aps.disturbances_us(start_us, end_us)
        frames: list[ApsFrame] = []
        first = 0
        for last in cut_block(self._travel(block), min(steps, self._flicker.longest_step)):
            self._step(block, first, last, frames)
            first = last
        noise = self._noise.block(self._block, span_ns, [1000 * (t - start_us) for t in bursts])
        keys = np.concatenate([self._dvs.take(), noise])
        rng = self._latency.block(self._block)
        events = self._readout.read(keys, 1000 * start_us, span_ns, rng)
        self._block += 1
        self._now_us, self._last = end_us, block
        return events, frames

    def _travel(self, block: SkinBlock) -> NDArray[np.float64]:
        """Return the motion of the fastest bead in each grid step [px]."""
        elastic = np.append(self._last.elastic_n[-1], block.elastic_n)
        patches = np.vstack([self._last.patches_mm[-1], block.patches_mm])
        slid = np.abs(np.diff(patches, axis=0)).max(axis=1)
        pressed = np.abs(np.diff(self._beads.reach_px(0, elastic)))
        return np.asarray(pressed + self._beads.px_per_mm * slid)

    def _draw(self, elastic_n: float) -> None:
        self._renderer.draw(
            self._beads.place_sheared(0, elastic_n, self._direction, self._skin.amounts())
        )

    def _step(self, block: SkinBlock, first: int, last: int, frames: list[ApsFrame]) -> None:
        """Advance pixels and frames over some grid steps of a block."""
        block_us = self._now_us
        start_us, end_us = block_us + first * STEP_US, block_us + last * STEP_US
        self._aps.expose_before(self._dvs.light, start_us, end_us)
        for k in range(first, last):
            self._skin.push(block.patches_mm[k])
        elastic, dirty = float(block.elastic_n[last - 1]), self._renderer.dirty
        self._draw(elastic)
        if self._mesh is not None:
            self._mesh.show(self._dvs, dirty, elastic)
        self._dvs.step(self._renderer.cover, dirty, 1000 * start_us, 1000 * end_us, 1000 * block_us)
        self._aps.expose_after(self._dvs.light, start_us, end_us)
        frame = self._aps.finish(end_us, self._brightness(end_us))
        if frame is not None:
            frames.append(frame)

    def _brightness(self, now_us: int) -> float:
        """Return the lamps' light over the device's, during the exposure that may end now."""
        day = self._conditions
        steady = day.light * (1.0 + day.light_drift_per_s * 1e-6 * now_us)
        start_us, end_us = self._aps.exposure_us
        return steady if end_us > now_us else steady * self._flicker.mean(start_us, end_us)
