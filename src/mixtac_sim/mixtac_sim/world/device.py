# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""One manufactured sensor, and one day in the laboratory, each drawn from its own seed.

A device holds the properties that differ between sensors; conditions hold those that differ
between trials on the same sensor.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator

from mixtac_sim.grids import log_uniform, stream
from mixtac_sim.mechanics.contact import PronySeries
from mixtac_sim.mechanics.elastomer import ForceLaw, Indenter, Layer, force_law
from mixtac_sim.optics.beads import BeadMotion
from mixtac_sim.optics.scene import (
    MESH_WIRE_MM,
    Flicker,
    Lens,
    Lighting,
    Markers,
    Scene,
    build_scene,
    scatter_markers,
)
from mixtac_sim.pixels.biases import PixelSettings, PixelSpread, draw_spread
from mixtac_sim.world.effects import EASY, LightEffects, OpticsEffects, Preset

LAMP_WARM_US = 600_000_000
"""Time after which the LEDs are warm [us] (estimate)."""
LARGEST_GROWTH = 0.005
"""Largest growth of the gel in a trial, as a part of its length."""
SECOND_MM = (4.0, 9.0)
"""Distance of a second contact from the first [mm]."""


@dataclass(frozen=True, slots=True)
class Conditions:
    """One day in the laboratory (spreads are estimates).

    Attributes:
        contact_mm: Contact point, right and down from the optical axis [mm].
        stiffness: Modulus over the device's: temperature, rest since the last trial.
        lean: Shear displacement per depth, to the right and downwards: the indenter comes in
            a few degrees off the normal.
        light: Light over the device's.
        light_drift_per_s: Relative change of the light per second while the LEDs warm up.
        supply_per_s: The same by the supply of the LEDs.
        friction: Friction over the device's.
        camera_shift_px: Shift of the camera, right and down [px].
        camera_roll_rad: Rotation of the camera [rad].
        exposure: Exposure over 7 ms, until one is set.
        growth_per_s: How fast the gel grows [1/s].
        second: Ratio of the forces of a second contact and the first; 0 for one contact.
        second_mm: Place of the second contact from the first, right and down [mm].
    """

    contact_mm: tuple[float, float]
    stiffness: float
    lean: tuple[float, float]
    light: float
    light_drift_per_s: float
    supply_per_s: float = 0.0
    friction: float = 1.0
    camera_shift_px: tuple[float, float] = (0.0, 0.0)
    camera_roll_rad: float = 0.0
    exposure: float = 1.0
    growth_per_s: float = 0.0
    second: float = 0.0
    second_mm: tuple[float, float] = (0.0, 0.0)

    def light_at(self, t_us: int) -> float:
        """Return the light over the device's at a time since the start of the trial [us]."""
        drift = self.light_drift_per_s + self.supply_per_s
        return self.light * max(1.0 + drift * 1e-6 * min(t_us, LAMP_WARM_US), 0.1)

    def growth_at(self, t_us: int) -> float:
        """Return how much the gel has grown at a time since the start of the trial [us]."""
        return min(self.growth_per_s * 1e-6 * t_us, LARGEST_GROWTH)


def draw_conditions(trial_seed: int, preset: Preset = EASY) -> Conditions:
    """Return the conditions of a trial."""
    rng, contact, light = stream(trial_seed, 'conditions'), preset.contact, preset.light
    more, optics = stream(trial_seed, 'more conditions'), preset.optics
    reach, wide = contact.place_mm, stream(trial_seed, 'wide conditions')
    away, angle = wide.uniform(*SECOND_MM), wide.uniform(0.0, 2.0 * np.pi)
    return Conditions(
        contact_mm=(rng.uniform(-reach, reach), rng.uniform(-reach, reach)),
        stiffness=rng.uniform(*preset.gel.day),
        lean=(rng.normal(0.0, contact.lean), rng.normal(0.0, contact.lean)),
        light=rng.uniform(*light.day),
        light_drift_per_s=rng.uniform(*light.drift_per_s),
        friction=more.uniform(*contact.friction_day),
        camera_shift_px=(more.normal(0.0, optics.shift_px), more.normal(0.0, optics.shift_px)),
        camera_roll_rad=float(np.radians(more.normal(0.0, optics.roll_deg))),
        exposure=more.uniform(*light.exposure),
        supply_per_s=wide.uniform(*light.supply_per_s),
        growth_per_s=wide.uniform(*preset.gel.growth_per_s),
        second=max(wide.uniform(*contact.second), 0.0),
        second_mm=(away * np.cos(angle), away * np.sin(angle)),
    )


def draw_flicker(trial_seed: int, light: LightEffects) -> Flicker:
    """Return the flicker of the lamp in a trial."""
    rng = stream(trial_seed, 'flicker')
    return Flicker(rng.uniform(*light.ripple), rng.random())


@dataclass(frozen=True, slots=True)
class DeviceModel:
    """One sensor.

    Attributes:
        seed: The device seed it was drawn from.
        layer: The sensing layer.
        mesh_n_per_mm: Stiffness of the mesh under it [N/mm].
        prony: Relaxation of the layer.
        friction: Coefficient of friction of the skin.
        markers: The beads.
        lens: The lens.
        lighting: Light and reflectances.
        scene: Light on the array at rest.
        spread: Differences between pixels.
        pixel_factors: Fields of `PixelSettings` of this chip over nominal ones.
        stiffening: Force over the linear layer's, less 1, per square of the strain.
        frame_burst: Share of pixels that fire when a frame is reset or read.
        dn_per_lux_ms: Response of the frames [DN/(lx ms)].
        grain: Read noise of the frames over the specification's.
    """

    seed: int
    layer: Layer
    mesh_n_per_mm: float
    prony: PronySeries
    friction: float
    markers: Markers
    lens: Lens
    lighting: Lighting
    scene: Scene
    spread: PixelSpread
    pixel_factors: Mapping[str, float]
    stiffening: float
    frame_burst: float
    dn_per_lux_ms: float
    grain: float

    def on_day(self, conditions: Conditions) -> DeviceModel:
        """Return the sensor as it is on the day of a trial: gel, skin, place of the camera."""
        (x, y), (right, down) = self.lens.centre_px, conditions.camera_shift_px
        lens = replace(
            self.lens,
            centre_px=(x + right, y + down),
            roll_rad=self.lens.roll_rad + conditions.camera_roll_rad,
        )
        return replace(
            self,
            layer=replace(self.layer, modulus_kpa=self.layer.modulus_kpa * conditions.stiffness),
            friction=self.friction * conditions.friction,
            lens=lens,
            scene=build_scene(lens, self.lighting),
        )

    def law(self, indenter: Indenter) -> ForceLaw:
        """Return the force law of an indenter on layer and mesh."""
        return force_law(self.layer, indenter, self.mesh_n_per_mm, self.stiffening)

    def beads(self, contact_mm: tuple[float, float], indenters: Sequence[Indenter]) -> BeadMotion:
        """Return how the beads move under a contact; arguments as of `BeadMotion`."""
        stiffness, laws = self.mesh_n_per_mm, [self.law(each) for each in indenters]
        return BeadMotion(
            self.markers, self.lens, stiffness, self.layer, contact_mm, indenters, laws
        )

    def pixel_settings(self, nominal: PixelSettings, conditions: Conditions) -> PixelSettings:
        """Return what a nominal chip's settings become on this chip, on the day of a trial."""
        own = {name: getattr(nominal, name) * each for name, each in self.pixel_factors.items()}
        return replace(nominal, **own, drift_per_s=conditions.supply_per_s)


def draw_device(seed: int, preset: Preset = EASY) -> DeviceModel:
    """Return the sensor of a device seed.

    Ranges are those of shared knowledge about Shore A-5 silicones, DAVIS346 chips and small
    wide-angle lenses; what the paper does not state is an estimate.

    Args:
        seed: Device seed.
        preset: Spread of the devices.
    """
    rng, pixels, gel = stream(seed, 'device'), preset.pixels, preset.gel
    layer = Layer(
        modulus_kpa=float(
            np.clip(160.0 * np.exp(rng.normal(0.0, gel.modulus_log_sd)), 100.0, 300.0)
        ),
        thickness_mm=rng.uniform(*gel.thickness_mm),
    )
    wide = stream(seed, 'wide device')
    lens = _draw_lens(rng, layer.thickness_mm, preset.optics, wide)
    lighting = _draw_lighting(rng, preset, wide)
    common, skew = rng.normal(0.0, pixels.common_log_sd), rng.normal(0.0, pixels.skew_log_sd)
    # Draws added with the presets have separate streams, so that older draws do not change.
    more = stream(seed, 'device stiffening')
    return DeviceModel(
        seed=seed,
        layer=layer,
        mesh_n_per_mm=np.exp(rng.uniform(*np.log(gel.mesh_n_per_mm))),
        prony=_draw_prony(rng, seed, preset),
        friction=rng.uniform(*preset.contact.friction),
        markers=scatter_markers(
            seed, layer.thickness_mm, preset.optics.beads, wide.uniform(*preset.optics.bead_mm)
        ),
        lens=lens,
        lighting=lighting,
        scene=build_scene(lens, lighting),
        spread=draw_spread(seed, rng.uniform(*pixels.mismatch), preset.light.hot_pixels),
        pixel_factors=_draw_pixel_factors(rng, seed, preset, common, skew),
        stiffening=more.uniform(*preset.impact.stiffening),
        frame_burst=rng.uniform(*preset.light.frame_burst),
        dn_per_lux_ms=rng.uniform(0.85, 1.1),
        grain=log_uniform(wide, preset.light.grain),
    )


def _draw_pixel_factors(
    rng: Generator, seed: int, preset: Preset, common: float, skew: float
) -> dict[str, float]:
    """Return thresholds, speed and noise of a chip over nominal."""
    pixels, band, speed = preset.pixels, preset.bandwidth, stream(seed, 'device speed')
    noise = float(np.exp(rng.uniform(*pixels.noise_log))) * pixels.noise
    return {
        'threshold_on': float(np.exp(common + skew)) * pixels.threshold,
        'threshold_off': float(np.exp(common - skew)) * pixels.threshold,
        'source_follower_hz': log_uniform(speed, band.follower),
        'hz_per_lux': log_uniform(speed, band.per_lux),
        'refractory_us': log_uniform(speed, band.refractory),
        'leak_hz': noise,
        'leak_hz_per_lux': pixels.noise,
        'shot_hz': noise,
    }


def _draw_lens(rng: Generator, thickness_mm: float, optics: OpticsEffects, wide: Generator) -> Lens:
    """Return a 2.8 mm lens focused somewhere in the middle of the layer."""
    bend = wide.uniform(*optics.bend)
    return Lens(
        focal_mm=2.8 * rng.uniform(0.98, 1.02),
        f_number=rng.uniform(*optics.f_number),
        gap_mm=rng.uniform(11.5, 14.0),
        thickness_mm=thickness_mm,
        focus_depth_mm=thickness_mm * rng.uniform(0.3, 0.6),
        k1=bend * rng.uniform(-0.30, -0.22),
        k2=bend * rng.uniform(0.07, 0.10),
        centre_px=(172.5 + rng.normal(0.0, 3.0), 129.5 + rng.normal(0.0, 3.0)),
        softness_px=rng.uniform(1.4, 1.9),
    )


def _draw_lighting(rng: Generator, preset: Preset, wide: Generator) -> Lighting:
    """Return the light of a ring of LEDs, not quite even, and the device's reflectances."""
    return Lighting(
        lux=rng.uniform(150.0, 250.0) * log_uniform(wide, preset.light.lamp),
        tilt=(rng.uniform(-0.15, 0.15), rng.uniform(-0.15, 0.15)),
        bowl=rng.uniform(-0.15, 0.15) + wide.uniform(*preset.optics.even),
        skin=rng.uniform(0.03, 0.06),
        bead=rng.uniform(0.3, 0.5),
        wire=rng.uniform(0.05, 0.15),
        glare=rng.uniform(0.01, 0.03),
        mesh_angle=rng.uniform(0.0, 0.5 * np.pi),
        mesh_shift_mm=(rng.uniform(0.0, 1.08), rng.uniform(0.0, 1.08)),
        corner_px=rng.uniform(185.0, 215.0),
        wire_mm=MESH_WIRE_MM * max(wide.uniform(*preset.optics.wire), 0.0),
    )


def _draw_prony(rng: Generator, seed: int, preset: Preset) -> PronySeries:
    """Return slow branches of 6-14 % and fast ones with tan delta 0.1-0.25 at 100 Hz (easy).

    A branch of minutes is added where the preset asks for one.
    """
    creep = preset.creep
    slow = rng.uniform(*creep.slow, size=3)
    fast = rng.uniform(*preset.impact.fast, size=2)
    spread = np.exp(rng.normal(0.0, creep.times_log_sd, size=5))
    times = np.array([0.5e-3, 3e-3, 0.05, 1.0, 20.0]) * spread
    weights = [*fast, *slow]
    if creep.long[1] > 0.0:
        extra = stream(seed, 'device creep')
        weights.append(extra.uniform(*creep.long))
        times = np.append(times, extra.uniform(*creep.long_s))
    return PronySeries(tuple(map(float, weights)), tuple(map(float, times)))
