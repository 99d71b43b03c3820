# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Friction of the skin on an object: rate-and-state, with a surface that is not even.

mu = mu0 (1 + r(s)) + a ln(w / w0) + b ln(w0 theta / d), theta' = 1 - w theta / d (Dieterich's
ageing law; Marone 1998): a contact strengthens while it rests, resists a jump of the slip speed w
at once, and weakens to its sliding value over a slip of d. r(s) is the unevenness of the object's
surface over the slipped distance s. No constants for black Shore A-5 silicone are published;
every number here is an estimate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mixtac_sim.errors import SimulationError

REFERENCE_MM_S = 1.0
"""w0, the slip speed at which mu0 holds [mm/s]."""
CREEP_MM_S = 1e-3
"""Slip speed below which a contact counts as holding [mm/s] (choice)."""


@dataclass(frozen=True, slots=True)
class Friction:
    """Friction of one pair of surfaces.

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

    def __post_init__(self) -> None:
        """Refuse numbers without a meaning.

        Raises:
            SimulationError: A coefficient or length that is not positive.
        """
        positive = (self.mu, self.rate, self.slip_mm, self.grain_mm)
        if min(positive) <= 0.0 or self.ageing < 0.0 or self.roughness < 0.0:
            msg = f'{self}: mu, rate, slip_mm, grain_mm must be > 0, ageing and roughness >= 0'
            raise SimulationError(msg)

    def steady(self, slip_mm_s: float) -> float:
        """Return the coefficient in steady sliding at a slip speed [mm/s]."""
        return self.mu + (self.rate - self.ageing) * float(np.log(slip_mm_s / REFERENCE_MM_S))

    def static(self, rest_s: float) -> float:
        """Return the coefficient up to which a contact that rested for a time [s] holds."""
        aged = self.ageing * float(np.log(REFERENCE_MM_S * rest_s / self.slip_mm))
        return self.mu + aged + self.rate * float(np.log(CREEP_MM_S / REFERENCE_MM_S))

    def row(self) -> tuple[float, float, float, float]:
        """Return mu, rate, ageing and slip_mm for the kernels."""
        return self.mu, self.rate, self.ageing, self.slip_mm
