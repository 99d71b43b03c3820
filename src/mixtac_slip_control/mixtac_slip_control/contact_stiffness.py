# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""How stiff the contact is, from the arm's own advance and the force that follows it.

A Kalman filter on (f, k) with F = f + k x: the force f where the advance x is zero, which drifts as
the gel relaxes, and the stiffness k, which stays. Before anything has moved, k is what was assumed:
its upper bound is the stiffest plausible contact. Every force that comes with an advance narrows
it. `largest_advance` never uses the estimate but its upper bound, so what has not been measured
counts as stiff.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from mixtac_slip_control.errors import SlipControlError

LEAST_FORCE: Final = 1e-4
"""Least standard deviation of the force at rest [N]."""
LEAST_STIFFNESS: Final = 1.0
"""Least standard deviation of the stiffness [N/m]."""
MOST_RATIO: Final = 20.0
"""Forces are taken as no further apart: towards zero force, spheres have no stiffness."""


@dataclass(frozen=True, slots=True)
class StiffnessSettings:
    """What is assumed before anything was measured.

    Attributes:
        stiffest: Stiffest plausible contact of gel and object [N/m].
        force_noise: Standard deviation of a force estimate [N].
        drift: Random walk of the force at rest [N/sqrt(s)].
        sigmas: Standard deviations by which bounds lie above estimates.
        reserve: Stiffness of a fast step over that of a slow one, in which the gel relaxes.
    """

    stiffest: float = 2e4
    force_noise: float = 0.03
    drift: float = 0.03
    sigmas: float = 3.0
    reserve: float = 1.1

    def __post_init__(self) -> None:
        """Refuse settings without a meaning.

        Raises:
            SlipControlError: A value that is not positive, or a stiffening below 1.
        """
        numbers = (self.stiffest, self.force_noise, self.drift, self.sigmas, self.reserve)
        if not all(math.isfinite(v) and v > 0.0 for v in numbers) or self.reserve < 1.0:
            raise SlipControlError(
                'stiffness settings (stiffest, force_noise, drift, sigmas, reserve) = '
                f'{numbers}: give positive finite numbers, reserve at least 1'
            )


def stiffening(from_n: float, to_n: float) -> float:
    """Return the mean stiffness between two forces [N] over that at the first, as under a sphere.

    Hertz: F ~ x^(3/2). Flat contacts stiffen less.
    """
    if not to_n > from_n:
        return 1.0
    ratio = to_n / max(from_n, to_n / MOST_RATIO)
    return float((ratio - 1.0) / (1.5 * (ratio ** (2.0 / 3.0) - 1.0))) if ratio > 1.0 else 1.0


class ContactStiffness:
    """Estimates the stiffness of the contact and how far it may be pressed.

    Args:
        settings: What is assumed at first.

    Attributes:
        force: f, force at advance zero [N].
        stiffness: k [N/m].
        known: Whether a force was seen.
    """

    def __init__(self, settings: StiffnessSettings | None = None) -> None:
        self.settings = settings or StiffnessSettings()
        self.force = 0.0
        self.known = False
        self._stamp_us = 0
        self._advance = 0.0
        self._assume(self.settings.force_noise**2)

    @property
    def present(self) -> float:
        """Force at the latest advance, noise averaged away [N]."""
        return self.force + self.stiffness * self._advance

    @property
    def deviation(self) -> float:
        """Standard deviation of the stiffness [N/m]."""
        return math.sqrt(self._kk)

    @property
    def bound(self) -> float:
        """Upper bound of the stiffness [N/m]."""
        return max(self.stiffness, 0.0) + self.settings.sigmas * self.deviation

    def restart(self) -> float:
        """Count advances from here on and assume a stiff contact; return the force [N]."""
        x = self._advance
        variance = self._ff + x * (2.0 * self._fk + x * self._kk)
        self.force += self.stiffness * x
        self._advance = 0.0
        self._assume(max(variance, 0.0))
        return self.force

    def on_force(self, force_n: float, stamp_us: int, advance_m: tuple[float, float]) -> None:
        """Take a force and the advance that it belongs to.

        Args:
            force_n: Normal force [N].
            stamp_us: Its time, camera clock [us].
            advance_m: Least and most that the fingertip may have advanced at that time [m].
        """
        noise = self.settings.force_noise**2
        if not self.known:
            self.known, self.force, self._ff, self._stamp_us = True, force_n, noise, stamp_us
            return
        seconds = min(max(1e-6 * (stamp_us - self._stamp_us), 0.0), 1.0)
        self._stamp_us = stamp_us
        self._ff += self.settings.drift**2 * seconds
        low, high = advance_m
        x = self._advance = 0.5 * (low + high)
        # A place known to half the way between its ends, two standard deviations of it.
        noise += (0.25 * (high - low) * self.bound) ** 2
        self._correct(force_n, x, noise)

    def largest_advance(self, force_n: float) -> float:
        """Return the advance at which the force stays below a given one, by its bound [m].

        Args:
            force_n: Force to stay below [N].

        The smallest A >= 0 with f + s k A + z sqrt(var(f + k A)) = F, s the reserve times how much
        a round contact stiffens on the way; 0 if there is none.
        """
        settings = self.settings
        room = force_n - self.force
        slope = settings.reserve * stiffening(self.force, force_n) * max(self.stiffness, 0.0)
        z2 = settings.sigmas**2
        # (room - slope A)^2 = z^2 (ff + 2 A fk + A^2 kk), at slope A <= room.
        a = slope * slope - z2 * self._kk
        b = -2.0 * (room * slope + z2 * self._fk)
        c = room * room - z2 * self._ff
        if room <= 0.0 or c <= 0.0:
            return 0.0
        root = math.sqrt(max(b * b - 4.0 * a * c, 0.0))
        q = -b + root
        # The smaller positive root in the form that does not cancel; a may have any sign.
        return 2.0 * c / q if q > 0.0 else math.inf

    def _assume(self, variance: float) -> None:
        """Forget the stiffness: half the stiffest, its bound the stiffest."""
        self.stiffness = 0.5 * self.settings.stiffest
        self._ff, self._fk = variance, 0.0
        self._kk = (self.stiffness / self.settings.sigmas) ** 2

    def _correct(self, force_n: float, x: float, noise: float) -> None:
        """Apply one measurement F = f + k x."""
        gain_f, gain_k = self._ff + x * self._fk, self._fk + x * self._kk
        variance = gain_f + x * gain_k + noise
        residual = force_n - self.force - self.stiffness * x
        self.force += gain_f / variance * residual
        self.stiffness += gain_k / variance * residual
        # Rounding must not make a variance negative.
        self._ff = max(self._ff - gain_f * gain_f / variance, LEAST_FORCE**2)
        self._fk -= gain_f * gain_k / variance
        self._kk = max(self._kk - gain_k * gain_k / variance, LEAST_STIFFNESS**2)
