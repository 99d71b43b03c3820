# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The camera over moving beads: light, event pixels, noise, readout and frames.

Contact moves the beads in different ways (`mixtac_sim.world.sensor`, `mixtac_sim.grasp.skin`); all
else is the same for both.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mixtac_core.events.arrays import Events, Floats
from mixtac_sim.grids import BLOCK_STEPS, PIXELS, STEP_US, BlockStreams, cut_block, stream
from mixtac_sim.optics.scene import Flicker, MeshMotion, Renderer
from mixtac_sim.pixels.aps import Aps, ApsFrame, ApsSettings
from mixtac_sim.pixels.biases import PixelSettings
from mixtac_sim.pixels.dvs import Dvs
from mixtac_sim.pixels.noise import NoiseSource, Readout
from mixtac_sim.world.device import Conditions, DeviceModel
from mixtac_sim.world.effects import Preset


class Camera:
    """Pixels and frames of a sensor in a trial, advanced in blocks.

    Args:
        device: The sensor, on the day of the trial.
        conditions: Conditions of the trial.
        preset: Difficulty of the sensor.
        seed: Seed of the trial.
        spots: Images of the beads at the start [n, 4], as of `BeadMotion.place`.
        flicker: Flicker of the lamp.
        elastic_n: Elastic part of the normal force at the start [N].
    """

    def __init__(
        self,
        device: DeviceModel,
        conditions: Conditions,
        preset: Preset,
        seed: int,
        spots: Floats,
        flicker: Flicker,
        elastic_n: float = 0.0,
    ) -> None:
        self._device, self._conditions, self._seed = device, conditions, seed
        self._renderer = Renderer(device.markers.opacity)
        self._mesh = None
        if preset.optics.mesh_moves:
            self._mesh = MeshMotion(
                device.lens, device.lighting, device.mesh_n_per_mm, conditions.contact_mm
            )
        exposure = ApsSettings(exposure_us=round(7_000 * conditions.exposure))
        self._aps = Aps(device.seed, seed, device.dn_per_lux_ms, exposure, device.grain)
        settings = device.pixel_settings(PixelSettings(), conditions)
        self._dvs = Dvs(device.scene, device.spread, settings, stream(seed, 'pixel state'))
        self._show(spots, elastic_n)
        self._dvs.settle(self._renderer.cover)
        self._rest_light = self._dvs.light.ravel()[:PIXELS].copy()
        self._noise = self._noise_source(settings)
        self._flicker = flicker
        self._dvs.light_by(self._flicker)
        speed = preset.bandwidth
        self._readout = Readout(speed.service_ns, speed.latency_ns, speed.jitter_ns)
        self._latency = BlockStreams(seed, 'event latency')
        self._block = 0
        self._now_us = 0

    def _noise_source(self, settings: PixelSettings) -> NoiseSource:
        device = self._device
        return NoiseSource(
            self._rest_light, settings, device.spread, device.frame_burst, self._seed
        )

    def configure_pixels(self, nominal: PixelSettings) -> None:
        """Change the DVS settings from the next block on, as new biases would."""
        settings = self._device.pixel_settings(nominal, self._conditions)
        self._dvs.configure(settings)
        self._noise = self._noise_source(settings)

    def configure_aps(self, settings: ApsSettings) -> None:
        """Change the frame settings from the next exposure that has not begun."""
        self._aps.configure(settings)

    def advance(
        self,
        elastic_n: Floats,
        travel_px: Floats,
        longest: int,
        place: Callable[[int, int], Floats],
    ) -> tuple[Events, list[ApsFrame]]:
        """Return the events and the frames that ended over one block.

        Events that are still in the readout's queue at the end come with the next block. Times are
        true time [us] since the start.

        Args:
            elastic_n: Elastic part of the normal force at the end of each grid step [n] [N].
            travel_px: Motion of the fastest bead in each grid step [n] [px].
            longest: Most grid steps that may be computed as one.
            place: Returns the images of the beads after grid steps `first` to `last` - 1 of the
                block; called once per step, in order.
        """
        steps, start_us = len(elastic_n), self._now_us
        end_us, span_ns = start_us + steps * STEP_US, 1000 * steps * STEP_US
        bursts = self._aps.disturbances_us(start_us, end_us)
        frames: list[ApsFrame] = []
        aps, dvs, cover, dirty = self._aps, self._dvs, self._renderer.cover, self._renderer.dirty
        light = dvs.light
        first = 0
        for last in cut_block(travel_px, min(longest, BLOCK_STEPS)):
            from_us, to_us = start_us + first * STEP_US, start_us + last * STEP_US
            before_us, after_us = aps.shares_us(from_us, to_us)
            aps.expose(light, before_us)
            self._show(place(first, last), float(elastic_n[last - 1]))
            dvs.step(cover, dirty, 1000 * from_us, 1000 * to_us, 1000 * start_us)
            aps.expose(light, after_us)
            frame = aps.finish(to_us, self._brightness(to_us))
            if frame is not None:
                frames.append(frame)
            first = last
        noise = self._noise.block(self._block, span_ns, [1000 * (t - start_us) for t in bursts])
        keys = np.concatenate([self._dvs.take(), noise])
        rng = self._latency.block(self._block)
        events = self._readout.read(keys, 1000 * start_us, span_ns, rng)
        self._block += 1
        self._now_us = end_us
        return events, frames

    def _show(self, spots: Floats, elastic_n: float) -> None:
        """Bring the light up to date: beads, and the mesh that sags under an elastic force [N]."""
        self._renderer.draw(spots)
        level = self._mesh.level(elastic_n) if self._mesh is not None else None
        if self._mesh is not None and level is not None:
            self._dvs.blend(self._mesh, level)
            self._renderer.dirty[self._mesh.tiles] = 1

    def _brightness(self, now_us: int) -> float:
        """Return the lamp's light over the device's, during the exposure that may end now."""
        steady = self._conditions.light_at(now_us)
        start_us, end_us = self._aps.exposure_us
        return steady if end_us > now_us else steady * self._flicker.mean(start_us, end_us)
