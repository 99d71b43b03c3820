# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The skin under a held object: normal force, stick and slip of patches, motion of beads.

The gel under each patch is a shear spring to the mesh, neighbours pull at each other through the
skin, and a skin that moves sends a shear wave into the gel, which resists its speed (the
quasi-dynamic approximation of fault mechanics, Rice 1993). The layer's resonance, some 400 Hz, is
not modelled; beads see the wave as a delay. Where friction weakens within a slip that is short
against the weakening over the stiffness, patches stick and slip; otherwise they slide smoothly.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from mixtac_core.events.arrays import Events, Floats
from mixtac_sim import SimulationError
from mixtac_sim.grasp.objects import REFERENCE_MM_S, Friction
from mixtac_sim.grids import STEP_US
from mixtac_sim.mechanics.contact import Contact, ContactPath, Mode
from mixtac_sim.mechanics.elastomer import ForceLaw, Indenter, Layer, shear_stiffness, sheared_area
from mixtac_sim.optics.scene import Markers
from mixtac_sim.pixels.aps import ApsFrame
from mixtac_sim.world.camera import Camera
from mixtac_sim.world.device import Conditions, DeviceModel, draw_flicker
from mixtac_sim.world.effects import Preset

RINGS = ((0.0, 1), (0.4, 5), (0.8, 10))
"""Radius over the contact's, and number, of the patches of each ring."""
COUPLING = 0.5
"""Pull of the other patches over that of the gel below (estimate)."""
NODES = 512
"""Length of the table of the surface's unevenness, in thirds of a grain; it repeats after that."""
DENSITY_KG_M3 = 1000.0
"""Density of the gel (silicone: 970 to 1070) [kg/m3]."""
ITERATIONS = 2
"""Steps of fourth order towards the slip speed (Fritsch, Shafer and Crowley 1973)."""


def patch_places(radius_mm: float) -> Floats:
    """Return the centres of the patches of a contact [16, 2] [mm], from its centre."""
    places = []
    for share, count in RINGS:
        angle = 2.0 * np.pi * (np.arange(count) + 0.5 * (share > 0.5)) / count
        places.append(share * radius_mm * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    return np.concatenate(places)


class Skin(NamedTuple):
    """The skin under an object, in patches; shear, age and slid distance change.

    Attributes:
        radius_mm: Contact radius [mm].
        places_mm: Centres of the patches [16, 2] [mm] from the contact's.
        shear_mm: Displacement of each patch along the pull [16] [mm].
        age_s: State theta of each patch [16] [s].
        slid_mm: Distance the object has slipped on each patch [16] [mm].
        stiffness: Shear stiffness of the gel under each patch [16] [N/mm].
        shares: Share of the normal force on each patch [16].
        surface: Unevenness of the object along its slip [16, NODES].
        friction: Friction of the object on the skin.
        resistance: Resistance of a patch to the speed of the skin [N s/mm].
    """

    radius_mm: float
    places_mm: Floats
    shear_mm: Floats
    age_s: Floats
    slid_mm: Floats
    stiffness: Floats
    shares: Floats
    surface: Floats
    friction: Friction
    resistance: float


def make_skin(
    layer: Layer,
    radius_mm: float,
    friction: Friction,
    rng: np.random.Generator,
    *,
    round_face: bool = False,
) -> Skin:
    """Return a skin that nothing has pulled at.

    Args:
        layer: The sensing layer.
        radius_mm: Contact radius [mm].
        friction: Against the object.
        rng: Draws the object's surface.
        round_face: Whether pressure falls towards the rim, as under a ball.
    """
    places = patch_places(radius_mm)
    count = len(places)
    away = np.hypot(*places.T) / radius_mm
    pressure = np.sqrt(1.0 - away**2) if round_face else np.ones(count)
    return Skin(
        radius_mm,
        places,
        shear_mm=np.zeros(count),
        age_s=np.full(count, 1e-3),
        slid_mm=np.zeros(count),
        stiffness=np.full(count, shear_stiffness(layer, radius_mm) / count),
        shares=pressure / pressure.sum(),
        surface=_surface(rng, count, friction.roughness),
        friction=friction,
        resistance=wave_resistance(layer, radius_mm) / count,
    )


def wave_speed_mm_s(layer: Layer) -> float:
    """Return the speed of shear waves in the gel [mm/s]."""
    return 1e3 * float(np.sqrt(1e3 * layer.modulus_kpa / 3.0 / DENSITY_KG_M3))


def wave_resistance(layer: Layer, radius_mm: float) -> float:
    """Return the force per speed of the skin that goes into shear waves [N s/mm]."""
    area_m2 = 1e-6 * float(sheared_area(radius_mm, layer.thickness_mm))
    return 1e-6 * DENSITY_KG_M3 * wave_speed_mm_s(layer) * area_m2


def _surface(rng: np.random.Generator, count: int, deviation: float) -> Floats:
    """Return smooth random numbers around a circle [count, NODES] of a standard deviation."""
    noise = rng.standard_normal((count, NODES))
    smooth = sum(np.roll(noise, k, axis=1) for k in (-1, 0, 1))
    return np.asarray(deviation / np.sqrt(3.0) * smooth)


@njit(cache=True, nogil=True, error_model='numpy')
def slip_speed(drive_n: float, strength_n: float, rate_n: float, damping: float) -> float:
    """Return the slip speed w [mm/s] at which rate_n ln(w) + strength_n + damping w = drive_n.

    Args:
        drive_n: Force that drives the slip [N], not negative.
        strength_n: Friction at 1 mm/s [N].
        rate_n: Friction per factor e of the speed [N].
        damping: Loss of the driving force with the speed [N s/mm], positive.
    """
    if drive_n <= 0.0:
        return 0.0
    # With y = damping w / rate the equation is y + ln y = z, solved by the Wright omega function.
    level = (drive_n - strength_n) / rate_n
    z = level + np.log(damping / rate_n)
    if z < -30.0:
        return float(np.exp(level))
    start = np.exp(2.0 / 3.0 * (z - 1.0) if z > -2.0 else z)
    y = z - np.log(z) if z > 1.0 else start
    for _ in range(ITERATIONS):
        short = z - y - np.log(y)
        slope = 2.0 * (1.0 + y) * (1.0 + y + 2.0 / 3.0 * short)
        y *= 1.0 + short / (1.0 + y) * (slope - short) / (slope - 2.0 * short)
    return float(y * rate_n / damping)


@njit(cache=True, nogil=True, error_model='numpy')
def slide(skin: Skin, normal_n: float, speed_mm_s: float, step_s: float) -> float:
    """Advance all patches by one implicit step; return the pull [N].

    Args:
        skin: The skin; its state changes.
        normal_n: Normal force [N].
        speed_mm_s: Speed of the object [mm/s].
        step_s: Length of the step [s].
    """
    _, _, shear, age, slid, stiffness, shares, surface, friction, resistance = skin
    mu, rate, ageing, slip_mm, _, grain_mm = friction
    nodes_per_mm = 3.0 / grain_mm
    mean = np.mean(shear)
    pull = 0.0
    for i in range(shear.size):
        normal = max(normal_n * shares[i], 1e-6)
        place = abs(slid[i]) * nodes_per_mm
        low = int(place)
        part = place - low
        uneven = (1.0 - part) * surface[i, low % NODES] + part * surface[i, (low + 1) % NODES]
        strength = mu * (1.0 + uneven) + ageing * np.log(REFERENCE_MM_S * age[i] / slip_mm)
        # With the shear at the end of the step: drive - damping * w, for w the slip speed.
        damping = resistance + stiffness[i] * (1.0 + COUPLING) * step_s
        held = stiffness[i] * (shear[i] + COUPLING * (shear[i] - mean))
        drive = held + damping * speed_mm_s
        slip = slip_speed(abs(drive), normal * strength, normal * rate, damping)
        slip = slip if drive >= 0.0 else -slip
        shear[i] += step_s * (speed_mm_s - slip)
        slid[i] += abs(slip) * step_s
        decay = abs(slip) * step_s / slip_mm
        if decay < 1e-9:
            age[i] += step_s
        else:
            steady = step_s / decay
            age[i] = max(steady + (age[i] - steady) * np.exp(-decay), 1e-9)
        pull += stiffness[i] * shear[i] + resistance * (speed_mm_s - slip)
    return pull


SETTLE_S = 3.0
"""Time for which the force is held before anything happens [s]."""


class Press:
    """A fingertip that presses an object against a wall.

    Args:
        device: The sensor on the day.
        face: The object's face.
        object_n_per_mm: Stiffness of the object itself [N/mm].
        force_n: Force of the grasp [N], held for 3 s before the start.

    Attributes:
        device: The sensor on the day.
        face: The object's face.
        gel: Elastic force of layer and mesh alone under that face.
        elastic_n: Elastic part of the force at the start [N].
        stiffness_n_per_mm: Slope of the force over the travel of the fingertip at the start [N/mm].

    Raises:
        SimulationError: The gel model does not bear that force.
    """

    def __init__(
        self,
        device: DeviceModel,
        face: Indenter,
        object_n_per_mm: float,
        force_n: float,
    ) -> None:
        self.device, self.face = device, face
        self.gel = device.law(face)
        law = _in_series(self.gel, object_n_per_mm)
        slopes = np.gradient(law.force_n, law.step_mm)
        self.stiffness_n_per_mm = float(np.interp(force_n, law.force_n, slopes))
        self._contact = Contact([law], [0.0], device.prony)
        path = self.hold(np.full(round(1e6 * SETTLE_S / STEP_US), force_n))
        self._start_mm = float(path.position_mm[-1])
        self.elastic_n = float(path.elastic_n[-1])
        if self.elastic_n >= 0.98 * law.force_n[-1]:
            raise SimulationError(
                f'a grasp of {force_n:.2f} N is beyond what this gel model bears under '
                f'{face}, {law.force_n[-1]:.2f} N; press less'
            )

    def move(self, advance_mm: Floats) -> ContactPath:
        """Move the fingertip; return the contact on the 125 us grid.

        Args:
            advance_mm: Its place at the end of each step, inwards from the start [n] [mm].
        """
        return self._run(Mode.POSITION, self._start_mm + advance_mm)

    def hold(self, force_n: Floats) -> ContactPath:
        """Press with given forces [n] [N] on the grid; return the contact."""
        return self._run(Mode.FORCE, force_n)

    def press_anew(self, force_n: Floats, place_mm: float) -> ContactPath:
        """Press with given forces [n] [N]; the last is that of a place [mm] of the fingertip.

        As after another grasp: the wall has come to where the force is the wanted one.
        """
        path = self.hold(force_n)
        self._start_mm = float(path.position_mm[-1]) - place_mm
        return path

    def _run(self, mode: Mode, targets: Floats) -> ContactPath:
        count = len(targets)
        return self._contact.advance(
            np.full(count, mode, np.int8), targets, np.zeros(count, np.int8)
        )


def _in_series(gel: ForceLaw, object_n_per_mm: float) -> ForceLaw:
    """Return the force law of gel and object in series, over their travel together."""
    travel = gel.depths_mm + gel.force_n / object_n_per_mm
    even = np.linspace(0.0, travel[-1], len(travel))
    force = np.interp(even, travel, gel.force_n)
    return ForceLaw(float(even[1]), force, np.interp(even, travel, gel.radius_mm))


REACH = 0.6
"""Distance over which what patches differ by decays outside the contact, in thicknesses
(estimate)."""
SMALLEST_MM = 1.0
"""Smallest width of the part of the gel that one patch moves [mm]."""


class SkinBeads:
    """Turns the displacement of patches into that of beads.

    A bead follows the mean of the patches as the layer does (`BeadMotion`), and what those above it
    differ from the mean in proportion to its height over the mesh, both later by what a shear wave
    takes from the skin to it; reflections are not modelled.

    Args:
        beads: The beads at rest.
        layer: The layer on the day.
        contact_mm: Centre of the contact from the optical axis [mm].
        skin: The skin at the start, in steady state.
    """

    def __init__(
        self, beads: Markers, layer: Layer, contact_mm: tuple[float, float], skin: Skin
    ) -> None:
        at = np.stack([beads.x_mm, beads.y_mm], axis=1) - np.array(contact_mm)
        width = max(0.35 * skin.radius_mm, 0.5 * layer.thickness_mm, SMALLEST_MM)
        distance = np.linalg.norm(at[:, None] - skin.places_mm, axis=2)
        near = np.exp(-0.5 * (distance / width) ** 2) + 1e-12
        outside = np.maximum(np.hypot(*at.T) - skin.radius_mm, 0.0) / (REACH * layer.thickness_mm)
        height = 1.0 - beads.depth_mm / layer.thickness_mm
        share = near / near.sum(axis=1, keepdims=True)
        self._weights = share * (height * np.exp(-(outside**2)))[:, None]
        late = np.rint(beads.depth_mm / wave_speed_mm_s(layer) * 1e6 / STEP_US).astype(np.int64)
        self._past = np.tile(skin.shear_mm, (int(late.max()) + 1, 1))
        self._rows = [np.flatnonzero(late == k) for k in range(len(self._past))]
        self._mean_mm, self._more_mm = np.zeros((2, len(height)))

    def push(self, patches_mm: Floats) -> None:
        """Advance one grid step to displacements of the patches [patch] [mm]."""
        self._past[1:] = self._past[:-1]
        self._past[0] = patches_mm

    def amounts(self) -> tuple[Floats, Floats]:
        """Return the mean displacement of the skin that each bead follows now, and what is added.

        Both [n] [mm]; reused by the next call.
        """
        for past, rows in zip(self._past, self._rows, strict=True):
            mean = past.mean()
            self._mean_mm[rows] = mean
            self._more_mm[rows] = self._weights[rows] @ (past - mean)
        return self._mean_mm, self._more_mm


DOWN = (0.0, 1.0)
"""Direction of gravity in the image, right and down: the sensor is mounted upright."""


class SkinCamera:
    """The sensor's camera over a skin that sticks and slips, in blocks of any length.

    Blocks may be as short as 1 ms, so that an arm can answer within the next one.

    Args:
        conditions: Conditions of the trial.
        preset: Difficulty of the sensor.
        seed: Seed of the trial.
        press: The fingertip on the object.
        skin: The skin at the start.
        elastic_n: Elastic part of the normal force at the start [N]; by default that of the press.
    """

    def __init__(
        self,
        conditions: Conditions,
        preset: Preset,
        seed: int,
        press: Press,
        skin: Skin,
        elastic_n: float | None = None,
    ) -> None:
        device, contact_mm = press.device, conditions.contact_mm
        self._beads = device.beads(contact_mm, [press.face])
        self._moved = SkinBeads(device.markers, device.layer, contact_mm, skin)
        self._elastic_n = press.elastic_n if elastic_n is None else elastic_n
        self._patches_mm = skin.shear_mm.copy()
        spots = self._place(self._elastic_n)
        flicker = draw_flicker(seed, preset.light)
        self._camera = Camera(device, conditions, preset, seed, spots, flicker, self._elastic_n)
        self.configure_aps = self._camera.configure_aps
        self.configure_pixels = self._camera.configure_pixels

    def _place(self, elastic_n: float) -> Floats:
        return self._beads.place(0, elastic_n, DOWN, self._moved.amounts())

    def advance(self, elastic_n: Floats, patches_mm: Floats) -> tuple[Events, list[ApsFrame]]:
        """Return the events and the frames that ended over a block; times as of `Camera.advance`.

        Args:
            elastic_n: Elastic part of the normal force at the end of each step of 125 us [n] [N].
            patches_mm: Shear displacement of the patches there [n, patch] [mm].
        """

        def place(first: int, last: int) -> Floats:
            for k in range(first, last):
                self._moved.push(patches_mm[k])
            return self._place(float(elastic_n[last - 1]))

        pressed = self._beads.reach_px(0, np.append(self._elastic_n, elastic_n))
        slid = np.abs(np.diff(np.vstack([self._patches_mm, patches_mm]), axis=0)).max(axis=1)
        travel = np.abs(np.diff(pressed)) + self._beads.px_per_mm * slid
        output = self._camera.advance(elastic_n, travel, len(elastic_n), place)
        self._elastic_n, self._patches_mm = float(elastic_n[-1]), patches_mm[-1]
        return output
