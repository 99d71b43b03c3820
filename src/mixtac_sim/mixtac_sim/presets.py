# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""How hard the simulated sensor is: three presets of the ten effects, and what is between them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import TYPE_CHECKING

from mixtac_sim.effects import (
    EFFECTS,
    OFF,
    BandwidthEffects,
    ContactEffects,
    CreepEffects,
    DeviceEffects,
    GelEffects,
    ImpactEffects,
    LightEffects,
    OpticsEffects,
    PixelEffects,
    TimingEffects,
)
from mixtac_sim.errors import SimulationError

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ['EASY', 'EFFECTS', 'PRESETS', 'Preset', 'preset']


@dataclass(frozen=True, slots=True)
class Preset:
    """A degree of difficulty; every effect of ``EFFECTS`` is a field of the same name.

    Attributes:
        name: Name of the preset; effects that were switched off are appended.
        pixels: Thresholds and noise of event pixels.
        gel: Stiffness of layer and mesh.
        timing: Errors of the reference sensor and its clock.
        creep: Slow relaxation.
        optics: Images of beads and mesh.
        bandwidth: Speed of pixels and readout.
        light: Lamp, exposure, spurious events.
        contact: Place, shape, friction.
        impact: Large strain, loss, ringing.
        devices: Differences between devices.
    """

    name: str
    pixels: PixelEffects = field(default_factory=PixelEffects)
    gel: GelEffects = field(default_factory=GelEffects)
    timing: TimingEffects = field(default_factory=TimingEffects)
    creep: CreepEffects = field(default_factory=CreepEffects)
    optics: OpticsEffects = field(default_factory=OpticsEffects)
    bandwidth: BandwidthEffects = field(default_factory=BandwidthEffects)
    light: LightEffects = field(default_factory=LightEffects)
    contact: ContactEffects = field(default_factory=ContactEffects)
    impact: ImpactEffects = field(default_factory=ImpactEffects)
    devices: DeviceEffects = field(default_factory=DeviceEffects)

    def without(self, *effects: str) -> Preset:
        """Return this preset with some effects switched off, for ablations.

        Raises:
            SimulationError: Unknown effect.
        """
        unknown = [effect for effect in effects if effect not in EFFECTS]
        if unknown:
            msg = f'effect {unknown[0]!r} is unknown; choose among {", ".join(EFFECTS)}'
            raise SimulationError(msg)
        name = ' without '.join([self.name, *effects])
        changes = {effect: OFF[effect] for effect in effects}
        return replace(self, name=name, **changes)  # type: ignore[arg-type]


EASY = Preset('easy')
"""One shape, clean optics and a rigid mount: for a first look and quick tests."""

PAPER_LIKE = Preset(
    'paper_like',
    pixels=PixelEffects(common_log_sd=0.18, skew_log_sd=0.1, mismatch=(0.1, 0.2), threshold=1.15),
    gel=GelEffects(modulus_log_sd=0.3, thickness_mm=(3.0, 6.0), mesh_n_per_mm=(1.5, 10.0)),
    timing=TimingEffects(
        noise_n=(10e-3, 30e-3),
        coupling=0.01,
        slope_n=0.0,
        wave_n=0.0,
        wander_n=12e-3,
    ),
    creep=CreepEffects(slow=(0.02, 0.06), times_log_sd=0.3, long=(0.01, 0.03)),
    optics=OpticsEffects(mesh_moves=True, beads=(380, 500), shift_px=1.0, roll_deg=0.3),
    bandwidth=BandwidthEffects(follower=(0.35, 1.3), per_lux=(4.0, 16.0), refractory=(0.03, 5.0)),
    light=LightEffects(day=(0.92, 1.08), exposure=(0.8, 1.2), ripple=(0.002, 0.01)),
    contact=ContactEffects(
        place_mm=2.5,
        friction=(0.5, 1.3),
        friction_day=(0.7, 1.1),
        friction_load=1.0 / 3.0,
        partial_slip=True,
        staircase=True,
    ),
    impact=ImpactEffects(stiffening=(0.5, 2.0), ringing_hz=(250.0, 1300.0)),
)
"""The paper's bench as far as it is known: one hemisphere, the rest as uncertain as it is."""

HARD = Preset(
    'hard',
    pixels=PixelEffects(0.25, 0.15, (0.12, 0.25), (-0.7, 1.4), 2.0, threshold=1.15),
    gel=GelEffects(0.35, (3.0, 6.0), (1.0, 10.0), (0.88, 1.12)),
    timing=TimingEffects(
        delay_s=(1.6e-3, 5e-3),
        noise_n=(15e-3, 40e-3),
        cross_talk=0.02,
        coupling=0.02,
        slope_n=0.0,
        wave_n=0.0,
        wander_n=25e-3,
    ),
    creep=CreepEffects((0.03, 0.09), 0.4, (0.02, 0.06)),
    optics=OpticsEffects((1.6, 2.4), mesh_moves=True, beads=(350, 600), shift_px=3.0, roll_deg=1.0),
    bandwidth=BandwidthEffects((0.17, 1.3), (2.8, 16.0), (0.03, 5.0)),
    light=LightEffects(
        (0.8, 1.2),
        (-4e-4, 1e-4),
        (0.5, 1.8),
        (0.005, 0.03),
        hot_pixels=(50, 200),
        frame_burst=(2e-4, 2e-3),
    ),
    contact=ContactEffects(
        4.0,
        0.1,
        (0.4, 1.4),
        (0.5, 1.2),
        1.0 / 3.0,
        partial_slip=True,
        indenters=('hemisphere', 'small sphere', 'flat', 'edge'),
        staircase=True,
    ),
    impact=ImpactEffects((0.15, 0.6), (0.5, 3.0), (250.0, 600.0), (0.01, 0.04)),
)
"""Worse than a laboratory: any indenter, poor light, a loose mount."""

PRESETS: Mapping[str, Preset] = MappingProxyType(
    {each.name: each for each in (EASY, PAPER_LIKE, HARD)}
)
"""The presets by name."""


def preset(name: str) -> Preset:
    """Return a preset by its name.

    Raises:
        SimulationError: Unknown name.
    """
    if name not in PRESETS:
        msg = f'preset {name!r} is unknown; choose one of {", ".join(PRESETS)}'
        raise SimulationError(msg)
    return PRESETS[name]
