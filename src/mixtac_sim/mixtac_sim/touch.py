# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The contact of a block of time: forces, dent, shear, and where beads are as it goes on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mixtac_sim.bead_motion import BeadMotion
from mixtac_sim.contact import Contact
from mixtac_sim.contact_steps import STEP_US
from mixtac_sim.elastomer import Layer, force_law
from mixtac_sim.presets import EASY
from mixtac_sim.shear import Shear
from mixtac_sim.steps import BLOCK_STEPS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_sim.conditions import Conditions
    from mixtac_sim.device import DeviceModel
    from mixtac_sim.presets import Preset
    from mixtac_sim.segments import CommandSource

TRUTH_DTYPE = np.dtype(
    [('t_us', 'i8'), ('fx', 'f8'), ('fy', 'f8'), ('fz', 'f8'), ('depth_mm', 'f8')]
)
"""Truth at 1 kHz: true time [us], force on the skin [N] (right, down, normal), dent [mm]."""
TRUTH_EVERY = 8
"""Grid steps per row of truth."""


@dataclass(frozen=True, slots=True)
class ContactBlock:
    """Contact over one block; entry k is the state at the end of grid step k.

    Attributes:
        t_us: True time [32] [us].
        wrench: Force [N] and torque about the sensor's centre [Nm] [32, 6].
        depth_mm: Dent [32] [mm].
        elastic_n: Elastic part of the normal force [32] [N].
        shear_mm: Shear displacement [32, 2] [mm].
        indenter: Indenter of each step [32].
        travel_px: Motion of the fastest bead in each step [32] [px].
        longest: The most grid steps that may be taken at once.
    """

    t_us: NDArray[np.int64]
    wrench: NDArray[np.float64]
    depth_mm: NDArray[np.float64]
    elastic_n: NDArray[np.float64]
    shear_mm: NDArray[np.float64]
    indenter: NDArray[np.int8]
    travel_px: NDArray[np.float64]
    longest: int

    def truth(self) -> NDArray[np.void]:
        """Return the rows of truth in the block [4], ``TRUTH_DTYPE``."""
        rows = np.zeros(BLOCK_STEPS // TRUTH_EVERY, TRUTH_DTYPE)
        chosen = slice(TRUTH_EVERY - 1, None, TRUTH_EVERY)
        rows['t_us'] = self.t_us[chosen]
        for axis, name in enumerate(('fx', 'fy', 'fz')):
            rows[name] = self.wrench[chosen, axis]
        rows['depth_mm'] = self.depth_mm[chosen]
        return rows


class Touch:
    """The mechanical side of a trial, block by block.

    Args:
        device: The sensor.
        conditions: Of the trial.
        profile: What touches it.
        preset: How it slips.
    """

    def __init__(
        self,
        device: DeviceModel,
        conditions: Conditions,
        profile: CommandSource,
        preset: Preset = EASY,
    ) -> None:
        layer = Layer(device.layer.modulus_kpa * conditions.stiffness, device.layer.thickness_mm)
        tools = profile.indenters
        self._profile = profile
        self._laws = [
            force_law(layer, tool, device.mesh_n_per_mm, device.stiffening) for tool in tools
        ]
        self._contact = Contact(self._laws, [tool.mass_g for tool in tools], device.prony)
        slip = preset.contact
        self._shear = Shear(
            layer,
            device.friction * conditions.friction,
            conditions.lean,
            slip.friction_load,
            partial_slip=slip.partial_slip,
        )
        self._place = conditions.contact_mm
        self._last: tuple[float, NDArray[np.float64]] = (0.0, np.zeros(2))
        self.beads = BeadMotion(device, layer, conditions.contact_mm, tools, self._laws)

    def block(self, index: int) -> ContactBlock:
        """Return the contact over block ``index``; blocks must be asked for in order."""
        first = index * BLOCK_STEPS
        modes, targets, tools = self._profile.commands(first, BLOCK_STEPS)
        path = self._contact.advance(modes, targets, tools)
        radius = np.empty(BLOCK_STEPS)
        for tool in np.unique(tools):
            radius[tools == tool] = self._laws[tool].radius_at(path.elastic_n[tools == tool])
        shear_mm, pull = self._shear.at(path.force_n, path.depth_mm, radius)
        travel = self._travel(tools, path.elastic_n, shear_mm)
        self._last = (float(path.elastic_n[-1]), shear_mm[-1])
        t_us = (np.arange(first, first + BLOCK_STEPS, dtype=np.int64) + 1) * STEP_US
        wrench = self._wrench(pull, path.force_n)
        longest = self._profile.longest_step(first, BLOCK_STEPS)
        return ContactBlock(
            t_us, wrench, path.depth_mm, path.elastic_n, shear_mm, tools, travel, longest
        )

    def _travel(
        self,
        tools: NDArray[np.int8],
        elastic_n: NDArray[np.float64],
        shear_mm: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Return the motion of the fastest bead per step [px]."""
        tool = int(tools[-1])
        reach = self.beads.reach_px(tool, np.append(self._last[0], elastic_n))
        slide = np.diff(np.vstack([self._last[1], shear_mm]), axis=0)
        across = self.beads.px_per_mm * np.hypot(slide[:, 0], slide[:, 1])
        return np.asarray(np.abs(np.diff(reach)) + across)

    def _wrench(
        self, pull: NDArray[np.float64], force_n: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return force and torque of a push at the contact point."""
        x, y = (1e-3 * place for place in self._place)
        torque_z = x * pull[:, 1] - y * pull[:, 0]
        columns = (pull[:, 0], pull[:, 1], force_n, y * force_n, -x * force_n, torque_z)
        return np.stack(columns, axis=1)
