# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Difficulty of the simulated sensor: nine effects with their ranges, and presets of them.

A range is (low, high) of a uniform draw unless the field says otherwise; equal ends mean no spread.
Spreads are estimates wherever the modules that use them do not name a source. Defaults are those of
the preset `easy`; ``presets.yaml`` beside this file holds the other presets.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType

from mixtac_core.node.files import read_data, structure
from mixtac_sim import SimulationError

Range = tuple[float, float]


@dataclass(frozen=True, slots=True)
class PixelEffects:
    """Thresholds and noise of the event pixels.

    Attributes:
        common_log_sd: Spread between chips of both thresholds together [log-e].
        skew_log_sd: Spread between chips of ON over OFF, to either side [log-e].
        mismatch: Spread between pixels of a threshold over nominal.
        noise_log: Leak and shot noise of a chip over nominal [log-e].
        noise: Leak and shot noise over their usual rates; 0 for none.
        threshold: Thresholds over the set ones.
    """

    common_log_sd: float = 0.12
    skew_log_sd: float = 0.08
    mismatch: Range = (0.08, 0.16)
    noise_log: Range = (-0.7, 0.7)
    noise: float = 1.0
    threshold: float = 1.0


@dataclass(frozen=True, slots=True)
class GelEffects:
    """Stiffness of layer and mesh.

    Attributes:
        modulus_log_sd: Spread between devices of the modulus about 160 kPa [log-e]; 100 to 300 kPa.
        thickness_mm: Thickness of the layer [mm].
        mesh_n_per_mm: Stiffness of the mesh, drawn evenly in its logarithm [N/mm].
        day: Modulus over the device's on a day: temperature, rest since the last trial.
        growth_per_s: How fast the gel grows in a trial, by half a percent at most: silicone that
            warms by 10 K is 0.3 % longer [1/s].
    """

    modulus_log_sd: float = 0.25
    thickness_mm: Range = (3.5, 5.0)
    mesh_n_per_mm: Range = (3.0, 10.0)
    day: Range = (0.94, 1.06)
    growth_per_s: Range = (0.0, 0.0)


@dataclass(frozen=True, slots=True)
class TimingEffects:
    """Clock, delay and errors of the reference force sensor.

    Attributes:
        offset_s: Largest offset of its clock [s].
        drift_ppm: Largest drift of its clock [ppm].
        delay_s: Delay of its readings [s]; at least the filter's 1.6 ms.
        noise_n: Noise of a force [N]; of a torque a hundredth of it [Nm].
        cross_talk: Gain error and cross-talk between axes of one kind.
        coupling: Cross-talk between forces and torques, of a torque per 0.01 Nm and newton.
        slope_n: Warm-up over 25 s [N].
        wave_n: Slow wave [N].
        wander_n: Spread of a drift that saturates (Ornstein-Uhlenbeck process) [N].
        wander_s: Correlation time of that drift [s].
    """

    offset_s: float = 5.0
    drift_ppm: float = 100.0
    delay_s: Range = (1.6e-3, 3.0e-3)
    noise_n: Range = (8e-3, 20e-3)
    cross_talk: float = 0.01
    coupling: float = 0.0
    slope_n: float = 10e-3
    wave_n: float = 3e-3
    wander_n: float = 0.0
    wander_s: Range = (20.0, 60.0)


@dataclass(frozen=True, slots=True)
class CreepEffects:
    """Slow relaxation of the layer: creep under load, hysteresis.

    Attributes:
        slow: Weight of each of the branches of 0.05, 1 and 20 s.
        times_log_sd: Spread between devices of all relaxation times [log-e].
        long: Weight of a branch of minutes.
        long_s: Time of that branch [s].
    """

    slow: Range = (0.02, 0.05)
    times_log_sd: float = 0.15
    long: Range = (0.0, 0.0)
    long_s: Range = (100.0, 300.0)


@dataclass(frozen=True, slots=True)
class OpticsEffects:
    """Image of the beads through the lens.

    Attributes:
        f_number: f-number; a large one is in focus everywhere.
        wire: Thickness of the mesh's wires over 0.18 mm; 0 for no mesh in view.
        bend: Distortion, relative to a small wide-angle lens.
        even: How much the lamps make up for the darkness of the corners: added to the relative
            change of the light at 10 mm from the axis.
        bead_mm: Diameter of the beads [mm].
        mesh_moves: Whether the mesh is seen to sag under load.
        beads: Number of beads in view.
        shift_px: Spread between days of the camera's place [px].
        roll_deg: Spread between days of the camera's rotation [deg].
    """

    f_number: Range = (1.8, 2.8)
    wire: Range = (1.0, 1.0)
    bend: Range = (1.0, 1.0)
    even: Range = (0.0, 0.0)
    bead_mm: Range = (0.8, 0.8)
    mesh_moves: bool = False
    beads: tuple[int, int] = (450, 450)
    shift_px: float = 0.0
    roll_deg: float = 0.0


@dataclass(frozen=True, slots=True)
class BandwidthEffects:
    """Speed of pixels and readout.

    Attributes:
        follower: Corner of the source follower over nominal, drawn evenly in its logarithm.
        per_lux: Corner of the photoreceptor over nominal, likewise. The nominal 2.5 Hz/lx reads
            figures for light on a scene as light on the chip and is kept for `easy` alone. A DVS
            of 2008 reached 3 kHz at 1 klx on the scene (Lichtsteiner), which is 30 to 140 lx on
            its chip behind lenses of f/1.2 to f/2.8, and its photodiode had twice the area: 10
            to 50 Hz/lx. A photodiode of 75 um2, 25 fF and no feedback gain would give 7 Hz/lx.
        refractory: Blind time over nominal, likewise.
        service_ns: Time to read one event [ns]: 12 Mev/s (user guide; readout-delay article, 357).
        latency_ns: Shortest latency of an event [ns] (data sheet: best case about 20 us).
        jitter_ns: Spread of the additional latency [ns] (estimate; ICNS model: 10 us).
    """

    follower: Range = (1.0, 1.0)
    per_lux: Range = (1.0, 1.0)
    refractory: Range = (1.0, 1.0)
    service_ns: int = 80
    latency_ns: int = 20_000
    jitter_ns: float = 15_000.0


@dataclass(frozen=True, slots=True)
class LightEffects:
    """Lamp, exposure, and events that no contact caused.

    Attributes:
        lamp: Light of a device over the usual, drawn evenly in its logarithm.
        grain: Read noise of its frames over the specification's, likewise.
        day: Light over the device's on a day.
        drift_per_s: Relative change of the light while the LEDs warm up: of frames alone, as it
            makes no events [1/s].
        supply_per_s: The same where their supply drifts; this makes events [1/s].
        exposure: Exposure of a trial over 7 ms, unless one is set.
        ripple: Depth of the lamp's ripple: peak over mean, less 1; 0.05 at most.
        hot_pixels: Number of hot pixels, the upper end excluded.
        frame_burst: Share of pixels that fire when a frame is reset or read.
    """

    lamp: Range = (1.0, 1.0)
    grain: Range = (1.0, 1.0)
    day: Range = (0.97, 1.03)
    drift_per_s: Range = (-1e-4, 0.0)
    supply_per_s: Range = (0.0, 0.0)
    exposure: Range = (1.0, 1.0)
    ripple: Range = (0.0, 0.0)
    hot_pixels: tuple[int, int] = (10, 120)
    frame_burst: Range = (0.0, 3e-4)


@dataclass(frozen=True, slots=True)
class ContactEffects:
    """Place, indenters and friction of the contact.

    Attributes:
        place_mm: Largest distance of the contact from the axis, right and down [mm].
        lean: Spread of the shear displacement per depth: the indenter is not quite upright.
        second: Ratio of the forces of a second contact and the first; a draw below 0 is none.
        shake_mm: Amplitude of the vibration of the base under a contact [mm].
        friction: Coefficient of friction of a device's skin at 1 N.
        friction_day: Friction over the device's on a day: dust, humidity.
        friction_load: Friction falls as the force to the power of minus this (a single contact
            with constant shear stress: 1/3).
        partial_slip: Whether the rim of the contact slips before the whole does.
        indenters: Possible indenters; one is drawn for each trial.
        staircase: Whether ``static`` trials climb in steps; otherwise they are one hold.
    """

    place_mm: float = 1.5
    lean: float = 0.05
    second: Range = (0.0, 0.0)
    shake_mm: Range = (0.0, 0.0)
    friction: Range = (0.5, 1.2)
    friction_day: Range = (1.0, 1.0)
    friction_load: float = 0.0
    partial_slip: bool = False
    indenters: tuple[str, ...] = ('hemisphere',)
    staircase: bool = False


@dataclass(frozen=True, slots=True)
class ImpactEffects:
    """Effects that only fast and hard contacts show.

    Attributes:
        fast: Weight of each of the branches of 0.5 and 3 ms: loss at impact.
        stiffening: Force over the linear layer's, less 1, per square of the strain.
        ringing_hz: Resonance of the mount, drawn evenly in its logarithm [Hz]; 0 for a rigid one.
        ringing_damping: Damping ratio of that resonance.
    """

    fast: Range = (0.2, 0.55)
    stiffening: Range = (0.0, 0.0)
    ringing_hz: Range = (0.0, 0.0)
    ringing_damping: Range = (0.02, 0.06)


@dataclass(frozen=True, slots=True)
class Preset:
    """A degree of difficulty: the sizes of all effects.

    Attributes:
        pixels: Thresholds and noise of event pixels.
        gel: Stiffness of layer and mesh.
        timing: Errors of the reference sensor and its clock.
        creep: Slow relaxation.
        optics: Images of beads and mesh.
        bandwidth: Speed of pixels and readout.
        light: Lamp, exposure, spurious events.
        contact: Place, shape, friction.
        impact: Large strain, loss, ringing.
    """

    pixels: PixelEffects = field(default_factory=PixelEffects)
    gel: GelEffects = field(default_factory=GelEffects)
    timing: TimingEffects = field(default_factory=TimingEffects)
    creep: CreepEffects = field(default_factory=CreepEffects)
    optics: OpticsEffects = field(default_factory=OpticsEffects)
    bandwidth: BandwidthEffects = field(default_factory=BandwidthEffects)
    light: LightEffects = field(default_factory=LightEffects)
    contact: ContactEffects = field(default_factory=ContactEffects)
    impact: ImpactEffects = field(default_factory=ImpactEffects)


EASY = Preset()
"""One shape, clean optics and a rigid mount: for a first look and quick tests."""


_READ = read_data(Path(__file__).with_name('presets.yaml'))
PRESETS: Mapping[str, Preset] = MappingProxyType(
    {
        'easy': EASY,
        **{name: structure(_READ[name], Preset, name) for name in _READ},
    }
)
"""The presets by name."""
PAPER_LIKE = PRESETS['paper_like']
"""The conditions of the paper."""


def preset(name: str) -> Preset:
    """Return a preset by its name.

    Raises:
        SimulationError: Unknown name.
    """
    if name not in PRESETS:
        raise SimulationError(f'preset {name!r} is unknown; choose one of {", ".join(PRESETS)}')
    return PRESETS[name]
