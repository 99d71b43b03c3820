# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A grasp that the sensor watches: press, object, skin and camera in lock-step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mixtac_sim.bead_motion import BeadMotion
from mixtac_sim.conditions import draw_conditions
from mixtac_sim.contact_steps import STEP_US
from mixtac_sim.device import draw_device
from mixtac_sim.elastomer import Layer, force_law
from mixtac_sim.grasp.fall import fall
from mixtac_sim.grasp.hang import critical_force_n, hang
from mixtac_sim.grasp.objects import OBJECTS
from mixtac_sim.grasp.press import Press
from mixtac_sim.grasp.skin_beads import SkinBeads
from mixtac_sim.grasp.skin_camera import SkinBlock, SkinCamera, on_day
from mixtac_sim.presets import PAPER_LIKE
from mixtac_sim.random_streams import stream

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_events.arrays import Events
    from mixtac_sim.aps import ApsFrame
    from mixtac_sim.device import DeviceModel
    from mixtac_sim.grasp.objects import GraspSetup
    from mixtac_sim.presets import Preset

DOWN = (0.0, 1.0)
"""Gravity in the image: the sensor is mounted upright."""


@dataclass(frozen=True, slots=True, eq=False)
class GraspBlock:
    """What happened over a block; entry k is the state at the end of its grid step k (125 us).

    Attributes:
        t_us: True time [n] [us] since the start.
        object_mm: Place of the object [n] [mm], downwards from where it was held.
        speed_mm_s: Its speed [n] [mm/s].
        normal_n: Normal force [n] [N].
        pull_n: Pull of the skin on it [n] [N].
        slipped_mm: Mean slip over the skin at the end [mm].
        events: Events that left the chip; none without a camera.
        frames: Frames whose exposure ended.
    """

    t_us: NDArray[np.int64]
    object_mm: NDArray[np.float64]
    speed_mm_s: NDArray[np.float64]
    normal_n: NDArray[np.float64]
    pull_n: NDArray[np.float64]
    slipped_mm: float
    events: Events | None
    frames: list[ApsFrame]


class Grasp:
    """An object between the fingertip and a wall.

    The rotation of the object is not modelled: a ball slides at both contacts and does not roll.

    Args:
        setup: Object, force and blow.
        device_seed: The sensor.
        seed: The day, the object's surface, the noise.
        preset: How hard the sensor is.
        camera: Whether the sensor watches; without, a trial takes milliseconds.

    Attributes:
        device: The sensor.
        critical_n: Smallest normal force that holds the object, to 2 % [N].
        grasp_n: Normal force of the grasp [N]: the margin times that.
        stiffness_n_per_mm: Of the contact at the grasp force [N/mm].
    """

    def __init__(
        self,
        setup: GraspSetup,
        device_seed: int,
        seed: int,
        preset: Preset = PAPER_LIKE,
        *,
        camera: bool = True,
    ) -> None:
        self.setup = setup
        conditions, device = draw_conditions(seed, preset), draw_device(device_seed, preset)
        layer = Layer(device.layer.modulus_kpa * conditions.stiffness, device.layer.thickness_mm)
        face = OBJECTS[setup.name].face
        gel = force_law(layer, face, device.mesh_n_per_mm, device.stiffening)
        surface = int(stream(seed, 'grasp surface').integers(1 << 62))
        radius = float(gel.radius_at(setup.margin * 0.5 * setup.weight_n))
        self.critical_n = critical_force_n(setup, layer, radius, surface)
        self.grasp_n = setup.margin * self.critical_n
        self._press = Press(
            device, layer, face, setup.n_per_mm, self.grasp_n, setup.stiffness_n_per_mm
        )
        self.stiffness_n_per_mm = self._press.stiffness_n_per_mm
        self._skin, _ = hang(setup, layer, radius, self.grasp_n, surface)
        self._hanging = (self._skin.shear_mm.copy(), self._skin.age_s.copy())
        self._body = np.zeros(3)
        self._fixed = setup.constants()
        self._camera: SkinCamera | None = None
        if camera:
            today = on_day(device, conditions)
            beads = BeadMotion(today, layer, conditions.contact_mm, [face], [self._press.gel])
            moved = SkinBeads(today, layer, conditions.contact_mm, self._skin.places_mm, radius)
            self._camera = SkinCamera(
                today, conditions, preset, seed, beads, moved, DOWN, self._start()
            )
        self.device: DeviceModel = device

    def _start(self) -> SkinBlock:
        return SkinBlock(np.array([self._press.elastic_n]), self._skin.shear_mm[None].copy())

    @property
    def camera(self) -> SkinCamera | None:
        """Return the camera, None without one."""
        return self._camera

    def strike(self, speed_mm_s: float) -> None:
        """Let a blow come at the next step, beside that of the setup.

        Args:
            speed_mm_s: Speed that it gives the object [mm/s].
        """
        self._fixed = (*self._fixed[:4], float(self._body[0]), self._fixed[5], speed_mm_s)

    def put_back(self) -> None:
        """Put the object back to where it was held; the fingertip stays where it is."""
        self._body[1:] = 0.0
        self._skin.shear_mm[:], self._skin.age_s[:] = self._hanging
        self._skin.slid_mm[:] = 0.0

    def advance(self, advance_mm: NDArray[np.float64]) -> GraspBlock:
        """Go on while the fingertip moves.

        Args:
            advance_mm: Place of the fingertip at the end of each step of 125 us, towards the
                object from where the grasp began [n] [mm].
        """
        count = len(advance_mm)
        first_us = round(1e6 * self._body[0])
        normal, elastic = self._press.advance(advance_mm)
        path, patches = np.empty((count, 3)), np.empty((count, len(self._skin.shear_mm)))
        state, gel, law = self._skin.arrays()
        fall(self._body, self._fixed, state, gel, self._skin.surface, law, normal, path, patches)
        events: Events | None = None
        frames: list[ApsFrame] = []
        if self._camera is not None:
            events, frames = self._camera.advance(SkinBlock(elastic, patches))
        return GraspBlock(
            first_us + (np.arange(count, dtype=np.int64) + 1) * STEP_US,
            path[:, 0],
            path[:, 1],
            normal,
            path[:, 2],
            float(np.mean(self._skin.slid_mm)),
            events,
            frames,
        )
