# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What differs from trial to trial on one and the same sensor, drawn from the trial's seed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from mixtac_sim.presets import EASY
from mixtac_sim.random_streams import stream

if TYPE_CHECKING:
    from mixtac_sim.optics import Lens
    from mixtac_sim.presets import Preset


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
        friction: Friction over the device's.
        camera_shift_px: How far the camera has moved, right and down [px].
        camera_roll_rad: How far it has turned [rad].
        exposure: Exposure over 7 ms, where none is asked for.
    """

    contact_mm: tuple[float, float]
    stiffness: float
    lean: tuple[float, float]
    light: float
    light_drift_per_s: float
    friction: float = 1.0
    camera_shift_px: tuple[float, float] = (0.0, 0.0)
    camera_roll_rad: float = 0.0
    exposure: float = 1.0

    def lens(self, lens: Lens) -> Lens:
        """Return a device's lens where it is on that day."""
        x, y = lens.centre_px
        shift_x, shift_y = self.camera_shift_px
        centre = (x + shift_x, y + shift_y)
        return replace(lens, centre_px=centre, roll_rad=lens.roll_rad + self.camera_roll_rad)


def draw_conditions(trial_seed: int, preset: Preset = EASY) -> Conditions:
    """Return the conditions of a trial."""
    rng, contact, light = stream(trial_seed, 'conditions'), preset.contact, preset.light
    more, optics = stream(trial_seed, 'more conditions'), preset.optics
    reach = contact.place_mm
    return Conditions(
        contact_mm=(rng.uniform(-reach, reach), rng.uniform(-reach, reach)),
        stiffness=rng.uniform(*preset.gel.day),
        lean=(rng.normal(0.0, contact.lean), rng.normal(0.0, contact.lean)),
        light=rng.uniform(*light.day),
        light_drift_per_s=rng.uniform(*light.drift_per_s),
        friction=more.uniform(*contact.friction_day),
        camera_shift_px=(more.normal(0.0, optics.shift_px), more.normal(0.0, optics.shift_px)),
        camera_roll_rad=float(np.radians(more.normal(0.0, optics.roll_deg))),
        exposure=more.uniform(*light.exposure),
    )
