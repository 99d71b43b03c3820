# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the bias currents of a DAVIS346 make of its event pixels, by jAER's formulas.

Thresholds are (kappa_n / kappa_p^2) (C2 / C1) ln(I / I_diff), the source follower's corner is
I_sf / (2 pi U_T C1), the refractory time C V / I_refr (jAER: DavisConfig, AddressedIPotCF). They
hold to a factor; what they say about a change of a bias is worth more than what they say about a
chip.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping

DIFF, ON, OFF, PHOTORECEPTOR, FOLLOWER, REFRACTORY = 10, 11, 12, 14, 15, 16
"""Addresses of the biases in the register file."""
DEFAULT_REGISTERS: Mapping[int, int] = MappingProxyType(
    {DIFF: 17023, ON: 24575, OFF: 16415, PHOTORECEPTOR: 9133, FOLLOWER: 4365, REFRACTORY: 16797}
)
"""Register values that libcaer sends: Diff 4,39; On 5,255; Off 4,1; Pr 2,58; SF 1,16; Refr 4,25."""
FULL_SCALE_A = (11e-12, 94e-12, 756e-12, 6054e-12, 48437e-12, 387.5e-9, 3.1e-6, 24.8e-6)
"""Largest current of each coarse step [A] (libcaer)."""
LEAKAGE_A = 1e-14
"""Current of a source that is off [A] (estimate)."""
CAPACITOR_RATIO = 20.0
"""C1 over C2 (jAER; 24 by the drawn capacitors)."""
SLOPE_FACTOR = 0.7
"""kappa of both kinds of transistors (jAER)."""
THERMAL_V, FOLLOWER_F = 25e-3, 131e-15
"""Thermal voltage [V], capacitor C1 [F] (jAER)."""
REFRACTORY_C = 20e-15 * 0.8
"""Charge of the refractory capacitor: 20 fF at 0.8 V [C] (jAER)."""
LEAST_THRESHOLD = 0.01
"""Thresholds do not go below this [log-e] (v2e)."""


def current_a(register: int) -> float:
    """Return the current [A] of a coarse-fine bias register."""
    if not register & 1:
        return LEAKAGE_A
    coarse, fine = register >> 12 & 7, register >> 4 & 255
    return max(FULL_SCALE_A[coarse] * fine / 256.0, LEAKAGE_A)


@dataclass(frozen=True, slots=True)
class PixelBiases:
    """Currents of the pixel's biases [A].

    Attributes:
        diff: Of the differencing amplifier's comparator reference.
        on: Of the ON comparator.
        off: Of the OFF comparator.
        photoreceptor: Of the photoreceptor.
        follower: Of the source follower.
        refractory: Of the reset.
    """

    diff: float
    on: float
    off: float
    photoreceptor: float
    follower: float
    refractory: float

    @classmethod
    def from_registers(cls, registers: Mapping[int, int]) -> PixelBiases:
        """Return the currents of register values by address.

        What is missing or 0, as no host has written it yet, is at its default.
        """
        written = {place: value for place, value in registers.items() if value}
        known = {**DEFAULT_REGISTERS, **written}
        places = (DIFF, ON, OFF, PHOTORECEPTOR, FOLLOWER, REFRACTORY)
        return cls(*(current_a(known[place]) for place in places))

    def _threshold(self, log_ratio: float) -> float:
        return max(log_ratio / (SLOPE_FACTOR * CAPACITOR_RATIO), LEAST_THRESHOLD)

    @property
    def threshold_on(self) -> float:
        """Return the ON threshold [log-e]."""
        return self._threshold(float(np.log(self.on / self.diff)))

    @property
    def threshold_off(self) -> float:
        """Return the OFF threshold [log-e]."""
        return self._threshold(float(np.log(self.diff / self.off)))

    @property
    def source_follower_hz(self) -> float:
        """Return the corner of the source follower [Hz].

        Above half the photoreceptor's current the formula does not hold; the corner stays there.
        """
        follower = min(self.follower, 0.5 * self.photoreceptor)
        return float(follower / (2.0 * np.pi * THERMAL_V * FOLLOWER_F))

    @property
    def refractory_us(self) -> float:
        """Return the refractory time [us], a lower bound."""
        return 1e6 * REFRACTORY_C / self.refractory
