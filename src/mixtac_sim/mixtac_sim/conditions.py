# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What differs from trial to trial on one and the same sensor, drawn from the trial's seed."""

from __future__ import annotations

from dataclasses import dataclass

from mixtac_sim.random_streams import stream


@dataclass(frozen=True, slots=True)
class Conditions:
    """One day in the laboratory (spreads are estimates).

    Attributes:
        contact_mm: Where the indenter meets the skin, from the optical axis [mm].
        stiffness: Modulus over the device's: temperature, rest since the last trial.
        lean: Shear displacement per depth, to the right and downwards: the indenter comes in
            a few degrees off the normal.
        light: Light over the device's.
        light_drift_per_s: Relative change of the light per second, from warming LEDs.
    """

    contact_mm: tuple[float, float]
    stiffness: float
    lean: tuple[float, float]
    light: float
    light_drift_per_s: float


def draw_conditions(trial_seed: int) -> Conditions:
    """Return the conditions of a trial."""
    rng = stream(trial_seed, 'conditions')
    return Conditions(
        contact_mm=(rng.uniform(-1.5, 1.5), rng.uniform(-1.5, 1.5)),
        stiffness=rng.uniform(0.94, 1.06),
        lean=(rng.normal(0.0, 0.05), rng.normal(0.0, 0.05)),
        light=rng.uniform(0.97, 1.03),
        light_drift_per_s=rng.uniform(-1e-4, 0.0),
    )
