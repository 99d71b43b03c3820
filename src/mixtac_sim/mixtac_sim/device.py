# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A manufactured sensor: everything that a rebuild would change, drawn from one seed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from mixtac_sim.elastomer import Layer
from mixtac_sim.markers import Markers, scatter_markers
from mixtac_sim.optics import Lens
from mixtac_sim.pixels import PixelSettings, PixelSpread, draw_spread
from mixtac_sim.random_streams import stream
from mixtac_sim.scene import Lighting, Scene, build_scene
from mixtac_sim.viscoelasticity import PronySeries

if TYPE_CHECKING:
    from numpy.random import Generator


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
        threshold_factor: Thresholds of this chip over nominal, ON and OFF.
        noise_factor: Noise and leak of this chip over nominal.
        frame_burst: Share of pixels that fire when a frame is reset or read.
        dn_per_lux_ms: Response of the frames [DN/(lx ms)].
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
    threshold_factor: tuple[float, float]
    noise_factor: float
    frame_burst: float
    dn_per_lux_ms: float

    @property
    def serial_number(self) -> str:
        """Return the serial number of the device's camera: eight digits from the seed."""
        return f'{self.seed % 100_000_000:08d}'

    def pixel_settings(self, nominal: PixelSettings) -> PixelSettings:
        """Return what a nominal chip's settings become on this chip."""
        return replace(
            nominal,
            threshold_on=nominal.threshold_on * self.threshold_factor[0],
            threshold_off=nominal.threshold_off * self.threshold_factor[1],
            leak_hz=nominal.leak_hz * self.noise_factor,
            shot_hz=nominal.shot_hz * self.noise_factor,
        )


def draw_device(seed: int) -> DeviceModel:
    """Return the sensor of a device seed.

    Ranges are those of shared knowledge about Shore A-5 silicones, DAVIS346 chips and small
    wide-angle lenses; what the paper does not state is an estimate.
    """
    rng = stream(seed, 'device')
    layer = Layer(
        modulus_kpa=float(np.clip(160.0 * np.exp(rng.normal(0.0, 0.25)), 100.0, 300.0)),
        thickness_mm=rng.uniform(3.5, 5.0),
    )
    lens = _draw_lens(rng, layer.thickness_mm)
    lighting = _draw_lighting(rng)
    common, skew = rng.normal(0.0, 0.12), rng.normal(0.0, 0.08)
    return DeviceModel(
        seed=seed,
        layer=layer,
        mesh_n_per_mm=np.exp(rng.uniform(np.log(3.0), np.log(10.0))),
        prony=_draw_prony(rng),
        friction=rng.uniform(0.5, 1.2),
        markers=scatter_markers(seed, layer.thickness_mm),
        lens=lens,
        lighting=lighting,
        scene=build_scene(lens, lighting),
        spread=draw_spread(seed, rng.uniform(0.08, 0.16)),
        threshold_factor=(float(np.exp(common + skew)), float(np.exp(common - skew))),
        noise_factor=float(np.exp(rng.uniform(-0.7, 0.7))),
        frame_burst=rng.uniform(0.0, 3e-4),
        dn_per_lux_ms=rng.uniform(0.85, 1.1),
    )


def _draw_lens(rng: Generator, thickness_mm: float) -> Lens:
    """Return a 2.8 mm lens focused somewhere in the middle of the layer."""
    return Lens(
        focal_mm=2.8 * rng.uniform(0.98, 1.02),
        f_number=rng.uniform(1.8, 2.8),
        gap_mm=rng.uniform(11.5, 14.0),
        thickness_mm=thickness_mm,
        focus_depth_mm=thickness_mm * rng.uniform(0.3, 0.6),
        k1=rng.uniform(-0.30, -0.22),
        k2=rng.uniform(0.07, 0.10),
        centre_px=(172.5 + rng.normal(0.0, 3.0), 129.5 + rng.normal(0.0, 3.0)),
        softness_px=rng.uniform(1.4, 1.9),
    )


def _draw_lighting(rng: Generator) -> Lighting:
    """Return the light of a ring of LEDs, not quite even, and the device's reflectances."""
    return Lighting(
        lux=rng.uniform(150.0, 250.0),
        tilt=(rng.uniform(-0.15, 0.15), rng.uniform(-0.15, 0.15)),
        bowl=rng.uniform(-0.15, 0.15),
        skin=rng.uniform(0.03, 0.06),
        bead=rng.uniform(0.3, 0.5),
        wire=rng.uniform(0.05, 0.15),
        glare=rng.uniform(0.01, 0.03),
        mesh_angle=rng.uniform(0.0, 0.5 * np.pi),
        mesh_shift_mm=(rng.uniform(0.0, 1.08), rng.uniform(0.0, 1.08)),
        corner_px=rng.uniform(185.0, 215.0),
    )


def _draw_prony(rng: Generator) -> PronySeries:
    """Return slow branches that relax 6-14 % and fast ones with tan delta 0.1-0.25 at 100 Hz."""
    slow = rng.uniform(0.02, 0.05, size=3)
    fast = rng.uniform(0.2, 0.55, size=2)
    times = np.array([0.5e-3, 3e-3, 0.05, 1.0, 20.0]) * np.exp(rng.normal(0.0, 0.15, size=5))
    return PronySeries(tuple(map(float, (*fast, *slow))), tuple(map(float, times)))
