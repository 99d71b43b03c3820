# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Fast changes of the lamp: the ripple of a poor supply, or LEDs that are switched to dim them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mixtac_sim.contact_steps import STEP_US
from mixtac_sim.random_streams import stream
from mixtac_sim.steps import BLOCK_STEPS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_sim.effects import LightEffects

STEPS_PER_PERIOD = 10
"""Steps of the pixels per period of the light."""
SMALL = 0.05
"""Ripple up to which pixels take their steady response to it, at the steps that motion asks for:
a swing of 0.1 log-e is below every threshold, and it only shifts when others are crossed."""
DARK = 0.02
"""Light while the LEDs are switched off, over that while they are on (estimate: glare)."""


@dataclass(frozen=True, slots=True)
class Flicker:
    """Periodic light, 1 in the mean for a ripple and 1 at most for switched LEDs.

    Attributes:
        depth: Peak of the ripple over the mean, less 1; without meaning for switched LEDs.
        hz: Frequency [Hz]; 0 for steady light.
        phase: Phase at time 0 [turns].
        switched: Whether the LEDs are switched, half of the time on.
    """

    depth: float
    hz: float
    phase: float
    switched: bool = False

    @property
    def steady(self) -> bool:
        """Return whether the light does not change at all."""
        return self.hz <= 0.0 or (self.depth <= 0.0 and not self.switched)

    @property
    def small(self) -> bool:
        """Return whether it is a ripple that cannot make a pixel fire by itself."""
        return not self.switched and self.depth <= SMALL

    @property
    def longest_step(self) -> int:
        """Return the most grid steps that resolve it; a small ripple needs no steps of its own."""
        if self.steady or self.small:
            return BLOCK_STEPS
        return max(int(1e6 / (STEPS_PER_PERIOD * self.hz * STEP_US)), 1)

    def light(self, t_us: NDArray[np.float64] | float) -> NDArray[np.float64]:
        """Return the light at times [us] over the steady one."""
        turns = 1e-6 * np.asarray(t_us, np.float64) * self.hz + self.phase
        if self.switched:
            return np.where(turns % 1.0 < 0.5, 1.0, DARK)
        return np.asarray(1.0 + self.depth * np.sin(2.0 * np.pi * turns))

    def log_light(self, t_us: float) -> float:
        """Return the natural logarithm of the light at a time [us]; 0 if steady."""
        return 0.0 if self.steady else float(np.log(self.light(t_us)))

    def mean(self, start_us: float, end_us: float) -> float:
        """Return the mean light between two times [us], for an exposure; 1 if steady."""
        if self.steady:
            return 1.0
        edges = np.linspace(start_us, end_us, 513)
        return float(np.mean(self.light(0.5 * (edges[1:] + edges[:-1]))))


def draw_flicker(trial_seed: int, light: LightEffects) -> Flicker:
    """Return the flicker of a trial's light."""
    rng = stream(trial_seed, 'flicker')
    depth, phase = rng.uniform(*light.ripple), rng.random()
    if light.pwm_hz > 0.0:
        return Flicker(0.0, light.pwm_hz, phase, switched=True)
    return Flicker(depth, light.ripple_hz, phase)
