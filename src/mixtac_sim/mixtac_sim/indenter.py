# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What touches the sensor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from mixtac_sim.errors import SimulationError


@dataclass(frozen=True, slots=True)
class Indenter:
    """A rigid body with an axis of symmetry along the direction of the force.

    Attributes:
        shape: ``sphere`` (the contact grows with the force) or ``flat`` (a flat round face).
        radius_mm: Radius of the sphere or of the face [mm].
        mass_g: Mass that falls when it is dropped [g].
    """

    shape: Literal['sphere', 'flat']
    radius_mm: float
    mass_g: float = 0.0

    def __post_init__(self) -> None:
        """Refuse shapes that the layer solution does not know.

        Raises:
            SimulationError: Shape or radius out of range.
        """
        if self.shape not in {'sphere', 'flat'}:
            msg = f"indenter shape {self.shape!r} is unknown; use 'sphere' or 'flat'"
            raise SimulationError(msg)
        if not 0.5 <= self.radius_mm <= 50.0:
            msg = f'indenter radius {self.radius_mm} mm is outside 0.5 to 50 mm; choose another'
            raise SimulationError(msg)


HEMISPHERE = Indenter('sphere', 9.0)
"""The paper's 18 mm hemisphere (section 4.3)."""

WEIGHT_20_G = Indenter('flat', 6.0, mass_g=20.0)
"""The paper's 20 g cylinder (section 4.5); its face is not stated, 12 mm is an estimate."""
