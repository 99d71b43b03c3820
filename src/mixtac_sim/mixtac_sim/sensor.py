# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The whole sensor: contact, beads, pixels and frames, advanced in true time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from mixtac_sim.aps import Aps, ApsFrame, ApsSettings
from mixtac_sim.array_geometry import PIXELS
from mixtac_sim.conditions import Conditions, draw_conditions
from mixtac_sim.contact_steps import STEP_US
from mixtac_sim.device import DeviceModel, draw_device
from mixtac_sim.dvs import Dvs
from mixtac_sim.errors import SimulationError
from mixtac_sim.flicker import draw_flicker
from mixtac_sim.mesh_motion import MeshMotion
from mixtac_sim.noise import NoiseSource
from mixtac_sim.outbox import Outbox
from mixtac_sim.pixels import PixelSettings
from mixtac_sim.presets import EASY
from mixtac_sim.random_streams import BlockStreams, stream
from mixtac_sim.readout import Readout
from mixtac_sim.renderer import Renderer
from mixtac_sim.scene import build_scene
from mixtac_sim.steps import BLOCK_US, cut_block
from mixtac_sim.touch import TRUTH_DTYPE, ContactBlock, Touch

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_events.arrays import Events
    from mixtac_sim.presets import Preset
    from mixtac_sim.segments import CommandSource

__all__ = [
    'TRUTH_DTYPE',
    'ApsFrame',
    'ApsSettings',
    'PixelSettings',
    'SensorOutput',
    'TactileSensor',
]


@dataclass(frozen=True, slots=True, eq=False)
class SensorOutput:
    """What happened since the last call; every time is true time [us] since the trial's start.

    Attributes:
        events: Events that left the chip, sorted.
        frames: Frames whose readout ended.
        truth: Force and dent at 1 kHz, ``TRUTH_DTYPE``.
        wrench_us: Times of ``wrench`` [n], int64, at 8 kHz.
        wrench: Force [N] and torque [Nm] on the sensor [n, 6], for the reference sensor.
    """

    events: Events
    frames: list[ApsFrame]
    truth: NDArray[np.void]
    wrench_us: NDArray[np.int64]
    wrench: NDArray[np.float64]


class TactileSensor:
    """A simulated sensor in a trial.

    Output depends on the seeds, profile and settings alone, not on how often it is advanced.

    Args:
        device_seed: What a rebuild of the sensor would change.
        trial_seed: What another day would change.
        profile: What touches the sensor; after its end nothing does.
        aps: When frames are taken.
        pixels: Settings of the DVS pixels of a nominal chip.
        preset: How hard the sensor is.

    Attributes:
        device: The sensor's constants.
    """

    def __init__(
        self,
        device_seed: int,
        trial_seed: int,
        profile: CommandSource,
        aps: ApsSettings | None = None,
        pixels: PixelSettings | None = None,
        *,
        preset: Preset = EASY,
    ) -> None:
        self._conditions = draw_conditions(trial_seed, preset)
        self.device: DeviceModel = _on_day(draw_device(device_seed, preset), self._conditions)
        self._touch = Touch(self.device, self._conditions, profile, preset)
        self._renderer = Renderer(self.device.markers.opacity)
        settings = aps or ApsSettings(exposure_us=round(7_000 * self._conditions.exposure))
        self._aps = Aps(self.device.seed, trial_seed, self.device.dn_per_lux_ms, settings)
        self._build_pixels(trial_seed, pixels or PixelSettings())
        self._flicker = draw_flicker(trial_seed, preset.light)
        self._dvs.light_by(self._flicker)
        moves = preset.optics.mesh_moves
        self._mesh = MeshMotion(self.device, self._conditions.contact_mm) if moves else None
        speed = preset.bandwidth
        self._readout = Readout(speed.service_ns, speed.latency_ns, speed.jitter_ns)
        self._latency = BlockStreams(trial_seed, 'event latency')
        self._block = 0
        self._now_us = 0
        self._outbox = Outbox()

    def _build_pixels(self, trial_seed: int, nominal: PixelSettings) -> None:
        """Let the pixels settle on the beads at rest."""
        device, settings = self.device, self.device.pixel_settings(nominal)
        rng = stream(trial_seed, 'pixel state')
        self._dvs = Dvs(device.scene, device.spread, settings, rng)
        self._renderer.draw(self._touch.beads.place(0, 0.0, (0.0, 0.0)))
        self._dvs.settle(self._renderer.cover)
        self._trial_seed = trial_seed
        self._rest_light = self._dvs.light.ravel()[:PIXELS]
        self._noise = self._noise_source(settings)

    def _noise_source(self, settings: PixelSettings) -> NoiseSource:
        device = self.device
        return NoiseSource(
            self._rest_light, settings, device.spread, device.frame_burst, self._trial_seed
        )

    @property
    def events_lost(self) -> int:
        """Return how many events pixels and readout had to drop so far."""
        return self._dvs.lost + self._readout.lost

    def configure_pixels(self, nominal: PixelSettings) -> None:
        """Change the DVS settings from the next block of 4 ms on, as new biases would."""
        settings = self.device.pixel_settings(nominal)
        self._dvs.configure(settings)
        self._noise = self._noise_source(settings)

    def configure_aps(self, settings: ApsSettings) -> None:
        """Change the frame settings from the next exposure that has not begun."""
        self._aps.configure(settings)

    def advance(self, until_us: int) -> SensorOutput:
        """Return what happened from the last call's time to before ``until_us``.

        Args:
            until_us: True time since the trial's start [us], not before the last call's.

        Raises:
            SimulationError: Time would run backwards.
        """
        if until_us < self._now_us:
            msg = f'cannot advance to {until_us} us: already at {self._now_us} us; ask for later'
            raise SimulationError(msg)
        self._now_us = until_us
        while self._block * BLOCK_US < until_us:
            self._run_block()
        return SensorOutput(*self._outbox.take(until_us))

    def _run_block(self) -> None:
        """Compute the next 4 ms."""
        index, start_us = self._block, self._block * BLOCK_US
        contact = self._touch.block(index)
        bursts = self._aps.disturbances_us(start_us, start_us + BLOCK_US)
        first = 0
        for last in cut_block(contact.travel_px, min(contact.longest, self._flicker.longest_step)):
            self._step(contact, start_us, first, last)
            first = last
        noise = self._noise.block(index, 1000 * BLOCK_US, [1000 * (t - start_us) for t in bursts])
        keys = np.concatenate([self._dvs.take(), noise])
        rng = self._latency.block(index)
        events = self._readout.read(keys, 1000 * start_us, 1000 * BLOCK_US, rng)
        self._outbox.put(events, contact)
        self._block += 1

    def _step(self, contact: ContactBlock, block_us: int, first: int, last: int) -> None:
        """Advance pixels and frames over some grid steps of a block."""
        start_us, end_us = block_us + first * STEP_US, block_us + last * STEP_US
        self._aps.expose_before(self._dvs.light, start_us, end_us)
        k = last - 1
        shear = (float(contact.shear_mm[k, 0]), float(contact.shear_mm[k, 1]))
        spots = self._touch.beads.place(
            int(contact.indenter[k]), float(contact.elastic_n[k]), shear
        )
        renderer = self._renderer
        renderer.draw(spots)
        if self._mesh is not None:
            self._mesh.show(self._dvs, renderer.dirty, float(contact.elastic_n[k]))
        self._dvs.step(
            renderer.cover, renderer.dirty, 1000 * start_us, 1000 * end_us, 1000 * block_us
        )
        self._aps.expose_after(self._dvs.light, start_us, end_us)
        frame = self._aps.finish(end_us, self._brightness(end_us))
        if frame is not None:
            self._outbox.frames.append(frame)

    def _brightness(self, now_us: int) -> float:
        """Return the lamps' light over the device's, during the exposure that may end now."""
        day = self._conditions
        steady = day.light * (1.0 + day.light_drift_per_s * 1e-6 * now_us)
        start_us, end_us = self._aps.exposure_us
        return steady if end_us > now_us else steady * self._flicker.mean(start_us, end_us)


def _on_day(device: DeviceModel, conditions: Conditions) -> DeviceModel:
    """Return a device with its camera where it is on the day of the trial."""
    lens = conditions.lens(device.lens)
    if lens == device.lens:
        return device
    return replace(device, lens=lens, scene=build_scene(lens, device.lighting))
