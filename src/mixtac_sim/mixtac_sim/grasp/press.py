# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The normal side of a grasp: gel, mesh and object in series, pressed by the fingertip."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from mixtac_sim.contact import Contact, Mode
from mixtac_sim.contact_steps import STEP_US
from mixtac_sim.elastomer import ForceLaw, force_law
from mixtac_sim.errors import SimulationError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_sim.device import DeviceModel
    from mixtac_sim.elastomer import Layer
    from mixtac_sim.indenter import Indenter

SETTLE_S = 3.0
"""Time for which the force is held before anything happens [s]."""


class Press:
    """A fingertip that presses an object against a wall.

    Args:
        device: The sensor.
        layer: Its layer on the day.
        face: The object's face.
        object_n_per_mm: Stiffness of the object itself [N/mm].
        force_n: Force of the grasp [N], held for 3 s before the start.
        stiffness_n_per_mm: Stiffness of gel, mesh and object together at that force, if it is to
            be a given one [N/mm]; the gel is then taken as stiff or soft enough for it.

    Attributes:
        law: Elastic force over the travel of the fingertip.
        stiffness_n_per_mm: Its slope at the force of the grasp [N/mm].
    """

    def __init__(
        self,
        device: DeviceModel,
        layer: Layer,
        face: Indenter,
        object_n_per_mm: float,
        force_n: float,
        stiffness_n_per_mm: float | None = None,
    ) -> None:
        gel = force_law(layer, face, device.mesh_n_per_mm, device.stiffening)
        self.gel = gel
        self.law = _in_series(gel, object_n_per_mm)
        if stiffness_n_per_mm is not None:
            scale = _slope(self.law, force_n) / stiffness_n_per_mm
            self.law = replace(self.law, step_mm=self.law.step_mm * scale)
        self.stiffness_n_per_mm = _slope(self.law, force_n)
        self._contact = Contact([self.law], [0.0], device.prony)
        settle = np.full(round(1e6 * SETTLE_S / STEP_US), force_n)
        path = self._contact.advance(
            np.full(len(settle), Mode.FORCE, np.int8), settle, np.zeros(len(settle), np.int8)
        )
        self._start_mm = float(path.position_mm[-1])
        self.elastic_n = float(path.elastic_n[-1])
        if self.elastic_n >= 0.98 * self.law.force_n[-1]:
            msg = (
                f'a grasp of {force_n:.2f} N is beyond what this gel model bears under '
                f'{face}, {self.law.force_n[-1]:.2f} N; press less'
            )
            raise SimulationError(msg)

    def radius_mm(self) -> float:
        """Return the contact radius at the start [mm]."""
        return float(self.gel.radius_at(self.elastic_n))

    def advance(
        self, advance_mm: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Move the fingertip; return force and its elastic part [n] [N] on the 125 us grid.

        Args:
            advance_mm: Its place at the end of each step, inwards from the start [n] [mm].
        """
        count = len(advance_mm)
        path = self._contact.advance(
            np.full(count, Mode.POSITION, np.int8),
            self._start_mm + advance_mm,
            np.zeros(count, np.int8),
        )
        return path.force_n, path.elastic_n

    def hold_force(
        self, force_n: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Press with given forces [n] [N] on the grid; return force and its elastic part."""
        count = len(force_n)
        path = self._contact.advance(
            np.full(count, Mode.FORCE, np.int8), force_n, np.zeros(count, np.int8)
        )
        return path.force_n, path.elastic_n


def _in_series(gel: ForceLaw, object_n_per_mm: float) -> ForceLaw:
    """Return the force law of gel and object in series, over their travel together."""
    travel = gel.depths_mm + gel.force_n / object_n_per_mm
    even = np.linspace(0.0, travel[-1], len(travel))
    force = np.interp(even, travel, gel.force_n)
    return ForceLaw(float(even[1]), force, np.interp(even, travel, gel.radius_mm))


def _slope(law: ForceLaw, force_n: float) -> float:
    """Return the stiffness at a force [N/mm]."""
    return float(np.interp(force_n, law.force_n, np.gradient(law.force_n, law.step_mm)))
