# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The sensing layer on its mesh and the bodies that touch it: force over depth, and shear.

`INDENTERS` are the bodies of simulated trials, `LIVE_INDENTERS` those of the live sensor by names
that fit a ROS parameter.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType
from typing import Final, Literal

import numpy as np
from scipy.interpolate import PchipInterpolator

from mixtac_core.events.arrays import Floats
from mixtac_sim.mechanics.layer import ALPHA, punch_factor, solve_contact, solve_edge


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
INDENTERS: Mapping[str, Indenter] = MappingProxyType(
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
LIVE_INDENTERS: Final[Mapping[str, Indenter]] = MappingProxyType(
    {
        **{name.replace(' ', '_'): tool for name, tool in INDENTERS.items()},
        'weight_20_g': WEIGHT_20_G,
        'weight_50_g': Indenter('flat', WEIGHT_20_G.radius_mm, mass_g=50.0),
        'ball_5_g': Indenter('sphere', 9.0, mass_g=5.0),
    }
)
"""All objects by name; those with a mass can be put down or dropped, the last two are choices."""


DEPTHS = 2049
"""Rows of the depth table: the step is below 2 um, where the force is below 0.1 mN."""


@dataclass(frozen=True, slots=True)
class Layer:
    """The sensing layer, bonded to the mesh, incompressible and linear elastic.

    Attributes:
        modulus_kpa: Young's modulus after relaxation [kPa]; 100 to 300 for Shore A-5 (estimate).
        thickness_mm: From the skin to the mesh [mm]; not stated in the paper, 3 to 6 (estimate).
    """

    modulus_kpa: float
    thickness_mm: float

    @property
    def shear_mpa(self) -> float:
        """Shear modulus [MPa, or N/mm^2]."""
        return 1e-3 * self.modulus_kpa / 3.0


@dataclass(frozen=True, slots=True)
class ForceLaw:
    """Elastic force of one indenter on one layer and mesh, equally spaced in depth.

    Attributes:
        step_mm: Spacing of the depths [mm], from 0.
        force_n: Elastic force [2049] [N].
        radius_mm: Contact radius [2049] [mm].
        linear_n: Force of a linear layer that is dented as much [2049] [N]; none if it is linear.
    """

    step_mm: float
    force_n: Floats
    radius_mm: Floats
    linear_n: Floats | None = None

    @property
    def depths_mm(self) -> Floats:
        """Return the depths [2049] [mm]: travel of the indenter from first touch."""
        return np.arange(len(self.force_n), dtype=np.float64) * self.step_mm

    def force_at(self, depth_mm: float) -> float:
        """Return the elastic force [N] at a depth [mm]."""
        return float(np.interp(depth_mm, self.depths_mm, self.force_n))

    def depth_at(self, force_n: float) -> float:
        """Return the depth [mm] of an elastic force [N]."""
        return float(np.interp(force_n, self.force_n, self.depths_mm))

    def radius_at(self, force_n: Floats | float) -> Floats:
        """Return the contact radius [mm] under elastic forces [N]."""
        return np.asarray(np.interp(force_n, self.force_n, self.radius_mm))

    def linear_at(self, force_n: Floats) -> Floats:
        """Return the forces [N] at which a linear layer would be dented as much."""
        if self.linear_n is None:
            return force_n
        return np.asarray(np.interp(force_n, self.force_n, self.linear_n))


@lru_cache(maxsize=64)
def force_law(
    layer: Layer, indenter: Indenter, mesh_n_per_mm: float = np.inf, stiffening: float = 0.0
) -> ForceLaw:
    """Return the force law of an indenter on a layer that rests on a springy mesh.

    The mesh is a spring in series, 1 to 10 N/mm (estimate). Layer depths reach 3.2 mm for a flat
    face; for a sphere they end where the contact is 2.5 thicknesses or 60 % of the sphere's
    radius wide, for an edge at 40 % of the thickness. Linear elasticity understates forces beyond
    about 20 % strain; there stiffening adds ``stiffening`` times the square of depth over
    thickness (estimate: 0.5 to 3; rubber in compression gains 1.8 times at 40 %).

    Args:
        layer: The layer.
        indenter: The indenter.
        mesh_n_per_mm: Stiffness of the mesh [N/mm].
        stiffening: Force over the linear layer's, less 1, per square of the strain.
    """
    laws = {'flat': _flat_law, 'edge': _edge_law, 'sphere': _sphere_law}
    depth, linear, radius = laws[indenter.shape](layer, indenter)
    force = linear
    if stiffening > 0.0:
        force = linear * (1.0 + stiffening * (depth / layer.thickness_mm) ** 2)
    travel = depth + force / mesh_n_per_mm
    even = np.linspace(0.0, travel[-1], DEPTHS)
    columns = [np.interp(even, travel, column) for column in (force, radius, linear)]
    return ForceLaw(float(even[1]), columns[0], columns[1], columns[2] if stiffening else None)


_Law = tuple[Floats, Floats, Floats]


def _flat_law(layer: Layer, indenter: Indenter) -> _Law:
    """Return layer depth, force and radius of a flat face: F = 2 a E* kappa(a / h) depth."""
    radius_mm = indenter.radius_mm
    depth = np.linspace(0.0, 3.2, DEPTHS)
    factor = punch_factor(radius_mm / layer.thickness_mm)
    stiffness = 8.0 / 3.0 * 1e-3 * layer.modulus_kpa * radius_mm * factor
    return depth, stiffness * depth, np.full(DEPTHS, radius_mm)


def _sphere_law(layer: Layer, indenter: Indenter) -> _Law:
    """Return the law of a sphere: Hertz's for small contacts, steeper where the base is felt."""
    radius_mm = indenter.radius_mm
    contact = solve_contact('sphere')
    widest = min(ALPHA[-1], 0.6 * radius_mm / layer.thickness_mm)
    alpha = np.linspace(0.0, widest, 4 * DEPTHS)
    unit = (alpha * layer.thickness_mm) ** 2 / radius_mm
    # Half-space limits d = a^2 / R and int omega dx = 2 / 3 close the table at alpha = 0.
    knots = np.append(0.0, ALPHA)
    depth = unit * np.interp(alpha, knots, np.append(1.0, contact.depth))
    load = unit * np.interp(alpha, knots, np.append(2.0 / 3.0, contact.load))
    force = 8.0 / 3.0 * 1e-3 * layer.modulus_kpa * alpha * layer.thickness_mm * load
    return depth, force, alpha * layer.thickness_mm


def _edge_law(layer: Layer, indenter: Indenter) -> _Law:
    """Return the law of an edge; the force is a smooth curve between the solved depths."""
    contact = solve_edge(indenter.radius_mm, indenter.length_mm, layer.thickness_mm)
    depth = np.linspace(0.0, contact.depth_mm[-1], DEPTHS)
    force = layer.modulus_kpa * PchipInterpolator(contact.depth_mm, contact.force_n)(depth)
    return depth, force, np.interp(depth, contact.depth_mm, contact.radius_mm)


def sheared_area(radius: Floats | float, thickness: float) -> Floats:
    """Return the area of the gel that a pull shears: the contact, widened by half the thickness.

    Args:
        radius: Radius of the contact.
        thickness: Thickness of the gel, in the same unit; the area is in its square.
    """
    return np.asarray(np.pi * (radius + 0.5 * thickness) ** 2)


def shear_stiffness(layer: Layer, radius_mm: Floats | float) -> Floats:
    """Return the stiffness in shear of the gel under contacts of these radii [N/mm]."""
    area_mm2 = sheared_area(radius_mm, layer.thickness_mm)
    return np.asarray(layer.shear_mpa * area_mm2 / layer.thickness_mm)


LIGHT_N = 0.05
"""Friction does not grow further below this force [N] (estimate)."""


class Shear:
    """Shear displacement and force, limited by friction.

    What `sheared_area` returns is a block in simple shear (estimate). With
    partial slip the pull follows Cattaneo's and Mindlin's law of a sphere: it starts with the
    same stiffness and slides as a whole at 1.5 times the displacement.

    Args:
        layer: The sensing layer.
        friction: Coefficient of friction at 1 N.
        lean: Shear displacement per depth, to the right and downwards.
        friction_load: Friction falls as the force to the power of minus this.
        partial_slip: Whether the rim of the contact slips before the whole does.

    Attributes:
        lean: Shear displacement per depth, to the right and downwards [2].
        partial_slip: Whether the rim of the contact slips before the whole does.
    """

    def __init__(
        self,
        layer: Layer,
        friction: float,
        lean: tuple[float, float],
        friction_load: float = 0.0,
        *,
        partial_slip: bool = False,
    ) -> None:
        self._layer = layer
        self._friction = friction
        self._friction_load = friction_load
        self.partial_slip = partial_slip
        self.lean = np.array(lean)

    def at(self, force_n: Floats, depth_mm: Floats, radius_mm: Floats) -> tuple[Floats, Floats]:
        """Return displacement [n, 2] [mm] and force [n, 2] [N], right and down."""
        stiffness = self.stiffness(radius_mm)
        wanted = depth_mm[:, None] * self.lean
        pull = stiffness[:, None] * wanted
        size = np.maximum(np.hypot(pull[:, 0], pull[:, 1]), 1e-12)
        limit = self.limit(force_n)
        if self.partial_slip:
            slid = 1.0 - np.minimum(size / np.maximum(1.5 * limit, 1e-12), 1.0)
            share = (limit * (1.0 - slid**1.5) / size)[:, None]
        else:
            share = np.minimum(1.0, limit / size)[:, None]
        return share * wanted, share * pull

    def stiffness(self, radius_mm: Floats) -> Floats:
        """Return the stiffness of the skin under contacts of these radii [n] [N/mm]."""
        return shear_stiffness(self._layer, radius_mm)

    def turn_stiffness(self, radius_mm: Floats) -> Floats:
        """Return its stiffness against a turn about the normal [n] [N mm/rad]."""
        return np.asarray(16.0 / 3.0 * self._layer.shear_mpa * radius_mm**3)

    def limit(self, force_n: Floats) -> Floats:
        """Return the largest pull that friction bears under normal forces [n] [N]."""
        load = np.maximum(force_n, LIGHT_N) ** -self._friction_load
        return np.asarray(self._friction * load * force_n)
