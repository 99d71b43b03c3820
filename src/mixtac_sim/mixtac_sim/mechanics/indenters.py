# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The bodies that touch the sensor: spheres, flat faces, edges and weights.

`INDENTERS` are those of simulated trials, `LIVE_INDENTERS` those of the live sensor by names that
fit a ROS parameter.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, Literal

IndenterName = Literal[
    'hemisphere',
    'small sphere',
    'large sphere',
    'shallow sphere',
    'flat',
    'narrow flat',
    'wide flat',
    'edge',
]


@dataclass(frozen=True, slots=True)
class Indenter:
    """A rigid body that presses on the skin.

    Attributes:
        shape: ``sphere`` (the contact grows with the force), ``flat`` (a flat round face) or
            ``edge`` (a rounded straight edge across the image).
        radius_mm: Radius of the sphere, of the face or of the edge's rounding [mm].
        mass_g: Mass that falls when it is dropped [g].
        length_mm: Length of the edge [mm].
    """

    shape: Literal['sphere', 'flat', 'edge']
    radius_mm: float
    mass_g: float = 0.0
    length_mm: float = 0.0


HEMISPHERE = Indenter('sphere', 9.0)
"""The paper's 18 mm hemisphere (section 4.3)."""
WEIGHT_20_G = Indenter('flat', 6.0, mass_g=20.0)
"""The paper's 20 g cylinder (section 4.5); its face is not stated, 12 mm is an estimate."""
INDENTERS: Mapping[IndenterName, Indenter] = MappingProxyType(
    {
        'hemisphere': HEMISPHERE,
        'small sphere': Indenter('sphere', 4.0),
        'large sphere': Indenter('sphere', 25.0),
        'shallow sphere': Indenter('sphere', 40.0),
        'flat': Indenter('flat', 5.0),
        'narrow flat': Indenter('flat', 3.0),
        'wide flat': Indenter('flat', 7.0),
        'edge': Indenter('edge', 1.0, length_mm=10.0),
    }
)
"""Indenters of trials by name; all but the hemisphere are choices."""
WEIGHTS: Final[Mapping[str, Indenter]] = MappingProxyType(
    {
        'weight_20_g': WEIGHT_20_G,
        'weight_50_g': Indenter('flat', WEIGHT_20_G.radius_mm, mass_g=50.0),
        'ball_5_g': Indenter('sphere', 9.0, mass_g=5.0),
    }
)
"""Objects that can be put down or dropped; the last two are choices."""
LIVE_INDENTERS: Final[Mapping[str, Indenter]] = MappingProxyType(
    {**{name.replace(' ', '_'): tool for name, tool in INDENTERS.items()}, **WEIGHTS}
)
"""All objects by name."""
