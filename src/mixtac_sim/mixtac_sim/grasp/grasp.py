# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A grasp that the sensor watches: fingertip, object, skin and camera advance in lock-step.

The fingertip presses gel, mesh and object in series; the object falls or is struck against the pull
of the skin and the friction of the wall. At the start, they hold it with the smallest sufficient
force times a margin.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mixtac_core.events.arrays import Events, Floats
from mixtac_sim import SimulationError
from mixtac_sim.grasp.objects import OBJECTS, GraspSetup, ObjectMotion
from mixtac_sim.grasp.skin import SETTLE_S, Press, Skin, SkinCamera, make_skin, slide
from mixtac_sim.grids import STEP_US, stream
from mixtac_sim.mechanics.contact import ContactPath
from mixtac_sim.pixels.aps import ApsFrame
from mixtac_sim.world.device import draw_conditions, draw_device
from mixtac_sim.world.effects import PAPER_LIKE, Preset

FALL_SUBSTEPS = 8
"""Steps per grid step of 125 us while the object moves; a step at rest is one."""


@njit(cache=True, nogil=True, error_model='numpy')
def advance_object(
    body: Floats,
    motion: ObjectMotion,
    skin: Skin,
    normal_n: Floats,
    path: Floats,
    patches: Floats,
) -> None:
    """Advance the object over some grid steps.

    Args:
        body: Time [s], place [mm] and speed [mm/s] of the object, downwards; changed.
        motion: What moves and holds the object.
        skin: As in ``slide``; changed.
        normal_n: Normal force over each grid step [n] [N].
        path: Place [mm], speed [mm/s] and pull of the skin [N] at the end of each step [n, 3].
        patches: Shear of the patches at the end of each step [n, patch] [mm].
    """
    mass, weight, static, kinetic, knock_s, pulse_s, knock_mm_s = motion
    grid_s = 1e-6 * STEP_US
    for k in range(normal_n.size):
        pull = 0.0
        struck = knock_s - grid_s <= body[0] <= knock_s + pulse_s
        parts = FALL_SUBSTEPS if struck or body[2] != 0.0 else 1
        step = grid_s / parts
        for _ in range(parts):
            body[0] += step
            pull = slide(skin, normal_n[k], body[2], step)
            since = (body[0] - knock_s) / pulse_s
            impact = 0.0
            if 0.0 < since < 1.0:
                impact = 1e-3 * mass * knock_mm_s * 0.5 * np.pi / pulse_s * np.sin(np.pi * since)
            net = weight + impact - pull
            if body[2] == 0.0 and abs(net) <= static * normal_n[k]:
                continue
            way = np.sign(body[2]) if body[2] != 0.0 else np.sign(net)
            speed = body[2] + 1e3 * step * (net - way * kinetic * normal_n[k]) / mass
            # Dry friction stops a body but never reverses it.
            body[2] = 0.0 if speed * way < 0.0 else speed
            body[1] += step * body[2]
        path[k, 0], path[k, 1], path[k, 2] = body[1], body[2], pull
        patches[k] = skin.shear_mm


HOLD_S = 0.2
"""Time in which an object settles, and for which it must then stay to count as held [s]."""
MOVED_MM = 0.02
"""Largest motion of an object that stays [mm]."""
FALLEN_MM = 1.0
"""Motion after which it is not watched longer [mm]."""
SEARCH_STEP = 1.02
"""Step of the search for the smallest force."""
SEARCH_START = 0.95
"""Force from which the search goes up, over what the static frictions hold together."""
HOLD_STEPS = round(1e6 * HOLD_S / STEP_US)


def hold(setup: GraspSetup, press: Press, force_n: float, surface_seed: int) -> tuple[Skin, bool]:
    """Let skin and wall hold an object, loaded alike at first.

    Args:
        setup: The object.
        press: The fingertip at that force.
        force_n: Normal force [N].
        surface_seed: Draws the object's surface.

    Returns:
        The skin as it then is, and whether the object held.
    """
    rng = np.random.default_rng(surface_seed)
    is_round = OBJECTS[setup.name].face.shape == 'sphere'
    radius_mm = float(press.gel.radius_at(press.elastic_n))
    skin = make_skin(press.device.layer, radius_mm, setup.friction, rng, round_face=is_round)
    static = setup.friction.static(SETTLE_S)
    borne_n = setup.weight_n * static / (static + setup.wall_mu)
    skin.shear_mm[:], skin.age_s[:] = borne_n / skin.stiffness.sum(), SETTLE_S
    *_, settled, last = creep_mm(setup, skin, np.full(2 * HOLD_STEPS, force_n))
    if last > FALLEN_MM:
        return skin, False
    skin.slid_mm[:] = 0.0
    return skin, last - settled < MOVED_MM


def creep_mm(setup: GraspSetup, skin: Skin, normal_n: Floats) -> list[float]:
    """Return the places of an object that nothing strikes, from 0 on, each `HOLD_S` [mm].

    The list ends where it has fallen.

    Args:
        setup: The object.
        skin: Holds it; changed.
        normal_n: Normal force over each step of 125 us [n] [N].
    """
    body, places = np.zeros(3), [0.0]
    motion = setup.motion()._replace(knock_s=np.inf, pulse_s=1.0, knock_mm_s=0.0)
    for first in range(0, len(normal_n), HOLD_STEPS):
        part = normal_n[first : first + HOLD_STEPS]
        path, patches = np.empty((len(part), 3)), np.empty((len(part), len(skin.shear_mm)))
        advance_object(body, motion, skin, part, path, patches)
        places.append(float(body[1]))
        if places[-1] > FALLEN_MM:
            break
    return places


def critical_force_n(
    setup: GraspSetup,
    surface_seed: int,
    press: Callable[[float], Press],
    rest_s: float = 0.0,
) -> float:
    """Return the smallest force that holds an object, to 2 % [N].

    Args:
        setup: The object.
        surface_seed: Draws the object's surface.
        press: Returns the fingertip that presses with a force [N].
        rest_s: Time for which the object must stay after it has settled, with the fingertip at rest
            while the gel relaxes [s].

    Raises:
        SimulationError: Not even twice what the static frictions say holds it.
    """
    static = setup.weight_n / (setup.friction.static(SETTLE_S) + setup.wall_mu)
    force, still = SEARCH_START * static, np.zeros(round(1e6 * rest_s / STEP_US))
    while force < 2.0 * static:
        pressed = press(force)
        skin, held = hold(setup, pressed, force, surface_seed)
        if held and len(still):
            held = creep_mm(setup, skin, pressed.move(still).force_n)[-1] < MOVED_MM
        if held:
            return force
        force *= SEARCH_STEP
    raise SimulationError(f'no force up to {force:.2f} N holds {setup}; its surface is too uneven')


UNTOUCHED = 1 << 40
"""Added to the seed of a trial for the noise of the time before it."""
FREE_STEPS = 80
"""Grid steps that are simulated at once without contact: 10 ms."""


@dataclass(frozen=True, slots=True, eq=False)
class GraspBlock:
    """The grasp over a block; entry k is the state at the end of its grid step k (125 us).

    Attributes:
        t_us: True time [n] [us] since the start.
        object_mm: Place of the object [n] [mm], downwards from where it was held.
        speed_mm_s: Speed of the object [n] [mm/s].
        normal_n: Normal force [n] [N].
        pull_n: Pull of the skin on it [n] [N].
        events: Events that left the chip; empty without a camera.
        frames: Frames whose exposure ended.
    """

    t_us: NDArray[np.int64]
    object_mm: Floats
    speed_mm_s: Floats
    normal_n: Floats
    pull_n: Floats
    events: Events
    frames: list[ApsFrame]


class Grasp:
    """An object between the fingertip and a wall.

    The rotation of the object is not modelled: a ball slides at both contacts and does not roll.

    Args:
        setup: Object, force and impact.
        device_seed: Seed of the sensor.
        seed: Seed of the trial, for conditions, surface of the object and noise.
        preset: Difficulty of the sensor.
        camera: Whether to simulate the camera. Without it, a trial takes milliseconds to compute.
        rest_s: Time for which the smallest force must hold the object while the fingertip rests
            [s].

    Attributes:
        critical_n: Smallest normal force that holds the object, to 2 % [N].
        grasp_n: Normal force of the grasp [N]: the margin times `critical_n`.
        stiffness_n_per_mm: Stiffness of the contact at the grasp force [N/mm].
        camera: The camera, None without one.
    """

    def __init__(
        self,
        setup: GraspSetup,
        device_seed: int,
        seed: int,
        preset: Preset = PAPER_LIKE,
        *,
        camera: bool = True,
        rest_s: float = 0.0,
    ) -> None:
        self.setup = setup
        conditions = draw_conditions(seed, preset)
        device = draw_device(device_seed, preset).on_day(conditions)
        face = OBJECTS[setup.name].face
        surface = int(stream(seed, 'grasp surface').integers(1 << 62))

        def press(force_n: float) -> Press:
            return Press(device, face, setup.n_per_mm, force_n)

        self.critical_n = critical_force_n(setup, surface, press, rest_s)
        self.grasp_n = setup.margin * self.critical_n
        self._press = press(self.grasp_n)
        self.stiffness_n_per_mm = self._press.stiffness_n_per_mm
        self._skin, _ = hold(setup, self._press, self.grasp_n, surface)
        self._held = (self._skin.shear_mm.copy(), self._skin.age_s.copy())
        self._body = np.zeros(3)
        self._motion = setup.motion()
        self.camera: SkinCamera | None = None
        self._day = (conditions, preset)
        if camera:
            self.camera = SkinCamera(*self._day, seed, self._press, self._skin)
        self._seed = seed

    def strike(self, speed_mm_s: float) -> None:
        """Strike the object at the next step, instead of the impact of the setup.

        Args:
            speed_mm_s: Speed that the impact gives the object [mm/s].
        """
        self._motion = self._motion._replace(
            knock_s=float(self._body[0]), knock_mm_s=float(speed_mm_s)
        )

    def put_back(self) -> None:
        """Put the object back to where it was held; the fingertip stays where it is."""
        self._body[1:] = 0.0
        self._skin.shear_mm[:], self._skin.age_s[:] = self._held
        self._skin.slid_mm[:] = 0.0

    def free_frames(self, count: int) -> list[ApsFrame]:
        """Return frames of the same sensor and day, taken before anything touched it."""
        # A new skin is free of shear; another seed, because noise does not repeat.
        layer, radius_mm = self._press.device.layer, self._skin.radius_mm
        skin = make_skin(layer, radius_mm, self.setup.friction, np.random.default_rng(0))
        seed = self._seed + UNTOUCHED
        camera = SkinCamera(*self._day, seed, self._press, skin, elastic_n=0.0)
        frames = list[ApsFrame]()
        block = np.zeros(FREE_STEPS)
        while len(frames) < count:
            frames += camera.advance(block, np.zeros((FREE_STEPS, len(skin.shear_mm))))[1]
        return frames

    def advance(self, advance_mm: Floats) -> GraspBlock:
        """Advance by one block.

        Args:
            advance_mm: Displacement of the fingertip towards the object since the start of the
                grasp, at the end of each step of 125 us [n] [mm].
        """
        contact = self._press.move(advance_mm)
        normal, count = contact.force_n, len(advance_mm)
        path, patches = np.empty((count, 3)), np.empty((count, len(self._skin.shear_mm)))
        advance_object(self._body, self._motion, self._skin, normal, path, patches)
        return self._seen(contact, path, patches)

    def grip_anew(self, force_n: Floats, place_mm: float) -> GraspBlock:
        """Advance by one block in which a hand holds the object where it was held.

        The skin bears as much of the weight as its share of the grasp's force: nothing at 0 N.

        Args:
            force_n: Normal force over each step of 125 us [n] [N].
            place_mm: Place of the fingertip at the end, where it goes on [mm].
        """
        self.put_back()
        contact = self._press.press_anew(force_n, place_mm)
        share = np.minimum(contact.force_n / self.grasp_n, 1.0)
        patches = share[:, None] * self._held[0]
        self._skin.shear_mm[:] = patches[-1]
        path = np.zeros((len(share), 3))
        path[:, 2] = patches @ self._skin.stiffness
        self._body[0] += 1e-6 * STEP_US * len(share)
        return self._seen(contact, path, patches)

    def _seen(self, contact: ContactPath, path: Floats, patches: Floats) -> GraspBlock:
        """Return the block that ends now, as the camera sees it."""
        normal = contact.force_n
        count = len(normal)
        first_us = round(1e6 * self._body[0]) - count * STEP_US
        events, frames = Events.empty(), list[ApsFrame]()
        if self.camera is not None:
            events, frames = self.camera.advance(contact.elastic_n, patches)
        return GraspBlock(
            first_us + (np.arange(count, dtype=np.int64) + 1) * STEP_US,
            path[:, 0],
            path[:, 1],
            normal,
            path[:, 2],
            events,
            frames,
        )
