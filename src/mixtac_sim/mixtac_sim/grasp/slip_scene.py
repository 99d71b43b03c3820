# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""An object that moves over the sensor as prescribed.

For the development and measurement of slip detectors: the truth is known to the microsecond.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mixtac_events.arrays import Events, Floats
from mixtac_sim.grasp.objects import draw_friction
from mixtac_sim.grasp.skin import SETTLE_S, Press, Skin, SkinCamera
from mixtac_sim.grids import STEP_US
from mixtac_sim.mechanics.elastomer import Layer
from mixtac_sim.mechanics.indenters import Indenter
from mixtac_sim.optics.scene import Flicker
from mixtac_sim.pixels.aps import ApsFrame
from mixtac_sim.random_streams import stream
from mixtac_sim.world.device import draw_conditions, draw_device
from mixtac_sim.world.effects import PAPER_LIKE, Preset

FACE = Indenter('flat', 6.0)
"""Face of the object: 12 mm wide (choice)."""
STIFF_N_PER_MM = 100.0
"""Stiffness of a rigid object [N/mm]."""
FRICTION_RATIO = 0.95
"""Pull that the gel bears at the start over what friction holds: about to slip (choice)."""
RISE_S = 5e-4
"""Time in which a slipping object reaches its speed, and stops [s]."""
SCENE_SUBSTEPS = 8
"""Steps of the friction per grid step."""


@dataclass(frozen=True, slots=True, eq=False)
class SceneBlock:
    """One block of a scene; times are true time [us] since its start.

    Attributes:
        end_us: End of the block [us].
        events: Events that left the chip.
        frames: Frames whose exposure ended.
        normal_n: Normal force at the end [N].
        pull_n: Tangential force on the object at the end [N].
        object_mm: Place of the object along its way at the end [mm].
        slipped_mm: Mean slip over the skin at the end [mm].
    """

    end_us: int
    events: Events
    frames: list[ApsFrame]
    normal_n: float
    pull_n: float
    object_mm: float
    slipped_mm: float


class SlipScene:
    """A held object that is moved over the skin.

    Args:
        device_seed: Seed of the sensor.
        seed: Seed of the trial: conditions, surface of the object, direction of the slip, noise.
        preset: Difficulty of the sensor.
        force_n: Normal force [N].
        flicker: Flicker of the lamp; drawn from the preset by default.
        load_ratio: Pull at the start over what friction holds.
    """

    def __init__(
        self,
        device_seed: int,
        seed: int,
        preset: Preset = PAPER_LIKE,
        *,
        force_n: float = 0.7,
        flicker: Flicker | None = None,
        load_ratio: float = FRICTION_RATIO,
    ) -> None:
        conditions = draw_conditions(seed, preset)
        device = draw_device(device_seed, preset)
        layer = Layer(device.layer.modulus_kpa * conditions.stiffness, device.layer.thickness_mm)
        rng = stream(seed, 'slip scene')
        law = draw_friction(rng)
        self._press = Press(device, layer, FACE, STIFF_N_PER_MM, force_n)
        radius = float(self._press.gel.radius_at(self._press.elastic_n))
        self._skin = Skin(layer, radius, law, rng)
        self._skin.rest(load_ratio * law.static(SETTLE_S) * force_n, SETTLE_S)
        angle = rng.normal(0.5 * np.pi, 0.15)
        self._force_n, self._object_mm = force_n, 0.0
        direction = (float(np.cos(angle)), float(np.sin(angle)))
        self._camera = SkinCamera(
            device, conditions, preset, seed, self._press, self._skin, direction, flicker
        )
        self.light_by = self._camera.light_by

    def advance(self, speed_mm_s: Floats, force_n: Floats | None = None) -> SceneBlock:
        """Advance by one block.

        Args:
            speed_mm_s: Speed of the object at the end of each step of 125 us [n] [mm/s].
            force_n: Normal force over each step [n] [N]; that of the start if None.
        """
        wanted = np.full(len(speed_mm_s), self._force_n) if force_n is None else force_n
        path = self._press.hold(wanted)
        patches = self._skin.drag(speed_mm_s, path.force_n, 1e-6 * STEP_US, SCENE_SUBSTEPS)
        self._object_mm += 1e-6 * STEP_US * float(np.sum(speed_mm_s))
        events, frames = self._camera.advance(path.elastic_n, patches)
        return SceneBlock(
            self._camera.now_us,
            events,
            frames,
            float(path.force_n[-1]),
            self._skin.pull_n,
            self._object_mm,
            float(np.mean(self._skin.slid_mm)),
        )

    def play(
        self, speed_mm_s: Floats, force_n: Floats | None = None, block_steps: int = 8
    ) -> Iterator[SceneBlock]:
        """Yield the blocks of a whole profile; arrays as in ``advance``.

        Args:
            speed_mm_s: Speed of the object [n] [mm/s].
            force_n: Normal force [n] [N].
            block_steps: Grid steps of 125 us per block.
        """
        for first in range(0, len(speed_mm_s), block_steps):
            part = slice(first, first + block_steps)
            yield self.advance(speed_mm_s[part], None if force_n is None else force_n[part])


def knock_profile(speed_mm_s: float, onset_s: float, slip_s: float, total_s: float) -> Floats:
    """Return the speed of an object that is at rest, slips and rests again [n] [mm/s].

    Args:
        speed_mm_s: Speed of the slip [mm/s].
        onset_s: Start of the slip [s].
        slip_s: Duration of the slip [s].
        total_s: Length of the profile [s].
    """
    t = (np.arange(round(1e6 * total_s / STEP_US)) + 1) * 1e-6 * STEP_US
    up = np.clip((t - onset_s) / RISE_S, 0.0, 1.0)
    down = np.clip((onset_s + slip_s - t) / RISE_S, 0.0, 1.0)
    return np.asarray(speed_mm_s * np.minimum(up, down))
