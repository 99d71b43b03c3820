# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The paper's three objects between fingertip and wall, what hits them, and their friction.

The paper names a box, a deformable cup and a rigid ball, pressed with the smallest force that
holds, and a 100 g weight that falls 5 cm onto them. It gives no masses, frictions or stiffnesses:
those here are estimates, drawn for each trial.

Friction is rate-and-state with an uneven surface: mu = mu0 (1 + r(s)) + a ln(w / w0)
+ b ln(w0 theta / d), theta' = 1 - w theta / d (Dieterich's ageing law; Marone 1998). A contact
strengthens while it rests, resists a jump of the slip speed w at once, and weakens to its sliding
value over a slip of d; r(s) is the unevenness of the object's surface over the slipped distance s.
No constants for black Shore A-5 silicone are published; every number here is an estimate.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from mixtac_sim import SimulationError
from mixtac_sim.grids import log_uniform
from mixtac_sim.mechanics.contact import GRAVITY
from mixtac_sim.mechanics.elastomer import Indenter

REFERENCE_MM_S = 1.0
"""w0, the slip speed at which mu0 holds [mm/s]."""
CREEP_MM_S = 1e-3
"""Slip speed below which a contact counts as holding [mm/s] (choice)."""


class Friction(NamedTuple):
    """Friction of one pair of surfaces, also for compiled code.

    Attributes:
        mu: mu0, the coefficient at 1 mm/s in steady sliding.
        rate: a, direct effect per factor e of the slip speed.
        ageing: b, strength gained per factor e of the time at rest.
        slip_mm: d, slip over which a contact renews itself [mm].
        roughness: Standard deviation of r.
        grain_mm: Distance over which r changes [mm].
    """

    mu: float = 0.8
    rate: float = 0.012
    ageing: float = 0.02
    slip_mm: float = 0.05
    roughness: float = 0.05
    grain_mm: float = 0.15

    def static(self, rest_s: float) -> float:
        """Return the coefficient up to which a contact that rested for a time [s] holds."""
        aged = self.ageing * float(np.log(REFERENCE_MM_S * rest_s / self.slip_mm))
        return self.mu + aged + self.rate * float(np.log(CREEP_MM_S / REFERENCE_MM_S))


WEIGHT_KG = 0.1
"""Mass of the falling weight (paper) [kg]."""
DROP_M = 0.05
"""Height from which it falls (paper) [m]."""
WEIGHT_IMPULSE_N_S = WEIGHT_KG * float(np.sqrt(2.0 * GRAVITY * DROP_M))
"""Momentum of the falling weight [N s]: 0.099."""


@dataclass(frozen=True, slots=True)
class HeldObject:
    """A kind of object.

    Attributes:
        face: Face that touches the skin.
        mass_g: Range of the mass [g].
        n_per_mm: Range of the object's own stiffness [N/mm].
        mu: Range of its friction on the skin at 1 mm/s.
        wall_mu: Range of its static friction on the wall.
        pulse_s: Duration of the weight's impact [s].
    """

    face: Indenter
    mass_g: tuple[float, float]
    n_per_mm: tuple[float, float]
    mu: tuple[float, float]
    wall_mu: tuple[float, float]
    pulse_s: float


OBJECTS: Mapping[str, HeldObject] = MappingProxyType(
    {
        'box': HeldObject(Indenter('flat', 6.0), (60, 90), (20, 60), (0.7, 0.9), (0.4, 0.6), 1e-3),
        'cup': HeldObject(
            Indenter('sphere', 35.0), (25, 40), (0.7, 1.5), (0.7, 0.9), (0.4, 0.6), 3e-3
        ),
        'ball': HeldObject(
            Indenter('sphere', 20.0), (40, 60), (50, 100), (0.5, 0.7), (0.3, 0.5), 1e-3
        ),
    }
)
"""The objects by name."""
TRANSMITTED = (0.02, 0.05)
"""Share of the weight's momentum that arrives: the paper's 0.32 mm in 13 ms means a few percent."""
WALL_KINETIC = 0.9
"""Kinetic over static friction on the wall (estimate)."""


class ObjectMotion(NamedTuple):
    """What moves and holds an object, for compiled code.

    Attributes:
        mass_kg: Mass [kg].
        weight_n: Weight [N].
        static_mu: Static friction of the wall.
        kinetic_mu: Kinetic friction of the wall.
        knock_s: Start of the impact [s].
        pulse_s: Duration of the impact [s], a half sine.
        knock_mm_s: Speed that the impact gives the object [mm/s].
    """

    mass_kg: float
    weight_n: float
    static_mu: float
    kinetic_mu: float
    knock_s: float
    pulse_s: float
    knock_mm_s: float


@dataclass(frozen=True, slots=True)
class GraspSetup:
    """One object in one grasp, and the impact on it.

    Attributes:
        name: Kind of object.
        mass_g: Mass of the object [g].
        n_per_mm: Stiffness of the object itself [N/mm].
        friction: On the skin.
        wall_mu: Static friction on the wall; the kinetic one is 0.9 of it.
        margin: Grasp force over the smallest that holds.
        knock_mm_s: Speed that the impact gives the object [mm/s].
        pulse_s: Duration of the impact [s], a half sine.
        knock_s: Start of the impact [s].
    """

    name: str
    mass_g: float
    n_per_mm: float
    friction: Friction
    wall_mu: float
    margin: float
    knock_mm_s: float
    pulse_s: float
    knock_s: float

    @property
    def weight_n(self) -> float:
        """Return the object's weight [N]."""
        return 1e-3 * self.mass_g * GRAVITY

    def motion(self) -> ObjectMotion:
        """Return what moves and holds the object."""
        return ObjectMotion(
            mass_kg=1e-3 * self.mass_g,
            weight_n=self.weight_n,
            static_mu=self.wall_mu,
            kinetic_mu=WALL_KINETIC * self.wall_mu,
            knock_s=self.knock_s,
            pulse_s=self.pulse_s,
            knock_mm_s=self.knock_mm_s,
        )


def draw_setup(
    name: str,
    rng: np.random.Generator,
    *,
    margin: float = 1.05,
    knock_mm_s: float | None = None,
    knock_s: float = 0.6,
) -> GraspSetup:
    """Return a trial's grasp.

    Args:
        name: Kind of object.
        rng: Draws it.
        margin: Grasp force over the smallest that holds.
        knock_mm_s: Speed after the impact [mm/s], instead of a share.
        knock_s: Start of the impact [s].

    Raises:
        SimulationError: Unknown object.
    """
    if name not in OBJECTS:
        raise SimulationError(f'object {name!r} is unknown; choose among {", ".join(OBJECTS)}')
    kind = OBJECTS[name]
    mass = rng.uniform(*kind.mass_g)
    share = rng.uniform(*TRANSMITTED)
    # Spreads of the friction are estimates.
    return GraspSetup(
        name=name,
        mass_g=mass,
        n_per_mm=rng.uniform(*kind.n_per_mm),
        friction=Friction(
            mu=rng.uniform(*kind.mu),
            rate=rng.uniform(0.008, 0.016),
            ageing=rng.uniform(0.018, 0.026),
            slip_mm=log_uniform(rng, (3e-3, 0.05)),
            roughness=rng.uniform(0.03, 0.08),
            grain_mm=rng.uniform(0.08, 0.3),
        ),
        wall_mu=rng.uniform(*kind.wall_mu),
        margin=margin,
        knock_mm_s=1e6 * share * WEIGHT_IMPULSE_N_S / mass if knock_mm_s is None else knock_mm_s,
        pulse_s=kind.pulse_s,
        knock_s=knock_s,
    )
