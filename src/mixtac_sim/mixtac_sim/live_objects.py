# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What may touch the live sensor, by names that fit a ROS parameter."""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from mixtac_sim.indenter import INDENTERS, WEIGHT_20_G, Indenter

if TYPE_CHECKING:
    from collections.abc import Mapping

WEIGHTS: Final[Mapping[str, Indenter]] = MappingProxyType(
    {
        'weight_20_g': WEIGHT_20_G,
        'weight_50_g': Indenter('flat', WEIGHT_20_G.radius_mm, mass_g=50.0),
        'ball_5_g': Indenter('sphere', 9.0, mass_g=5.0),
    }
)
"""Objects that can be put down or dropped; the last two are choices."""

OBJECTS: Final[Mapping[str, Indenter]] = MappingProxyType(
    {**{name.replace(' ', '_'): tool for name, tool in INDENTERS.items()}, **WEIGHTS}
)
"""All objects by name."""
