# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""How far the arm may advance: stiffness of the contact, the probe that measures it, the bound.

The force is bounded ahead, not watched: an arm that is 10 ms late has pressed several newtons too
hard before a measured force shows it. `AdvanceBound` alone decides how far the arm may advance,
anew in every window: by the measured stiffness, by `max_force` and by `max_total`.

The stiffness comes from the arm's own advance and the force that follows it: a Kalman filter on
(f, k) with F = f + k x, where the force f at advance zero drifts as the gel relaxes and the
stiffness k is constant. Before anything has moved, the upper bound of k is the stiffest plausible
contact. `largest_advance` uses the upper bound, never the estimate, so an unmeasured contact counts
as stiff. Slip leaves no time to learn: the arm needs most of its advance within 20 ms. So when slip
control is enabled, `StiffnessProbe` presses a little, slowly, waits until the stiffness is known
well enough, and returns.
"""

from __future__ import annotations

import math
from typing import Final

from mixtac_slip_control.errors import SlipControlError
from mixtac_slip_control.parameters import SlipControlParameters

LEAST_FORCE: Final = 1e-4
"""Least standard deviation of the force at rest [N]."""
LEAST_STIFFNESS: Final = 1.0
"""Least standard deviation of the stiffness [N/m]."""
MOST_RATIO: Final = 20.0
"""Largest ratio of two forces: towards zero force, spheres have no stiffness."""
LEAST_SHARE: Final = 0.9
"""Share of the force at rest that is reckoned with at least, once the stiffness is known."""
DRIFT: Final = 0.03
"""Random walk of the force at rest, as the gel relaxes [N/sqrt(s)]."""
SIGMAS: Final = 3.0
"""Standard deviations by which bounds lie above estimates."""
RESERVE: Final = 1.1
"""Stiffness of a fast step over that of a slow one, in which the gel relaxes."""


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
        parameters: What is assumed before anything was measured.
        drift: Random walk of the force at rest [N/sqrt(s)].

    Attributes:
        force: f, force at advance zero [N].
        stiffness: k [N/m].
        known: Whether a force was seen.
    """

    def __init__(self, parameters: SlipControlParameters, drift: float = DRIFT) -> None:
        self._drift = drift
        self.configure(parameters)
        self.force = 0.0
        self.known = False
        self._stamp_us = 0
        self._advance = 0.0
        self._least = (-math.inf, -math.inf, 0.0)
        self._assume(self._noise**2)

    def configure(self, parameters: SlipControlParameters) -> None:
        """Use other parameters; what was measured stays."""
        self._stiffest, self._noise = parameters.stiffest_contact, parameters.force_noise

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
        return max(self.stiffness, 0.0) + SIGMAS * self.deviation

    def force_variance(self, advance: float) -> float:
        """Return the variance of the force that is expected at an advance [m], in N^2."""
        return self._ff + advance * (2.0 * self._fk + advance * self._kk)

    def restart(self) -> float:
        """Count advances from here on and assume a stiff contact; return the force [N]."""
        variance = self.force_variance(self._advance)
        self.force += self.stiffness * self._advance
        self._advance = 0.0
        self._assume(max(variance, 0.0))
        return self.force

    def settle(self) -> None:
        """Keep what was found as the least: from now on the contact may turn out stiffer only.

        A tactile sensor tells least of a fast press, which is how slip is answered: it would take
        a contact for soft, and let the arm press on.
        """
        self._least = (LEAST_SHARE * self.force, self.stiffness, self._kk)

    def on_force(self, force_n: float, stamp_us: int, advance_m: tuple[float, float]) -> None:
        """Learn from a force and the advance that it belongs to.

        Args:
            force_n: Normal force [N].
            stamp_us: Its time, camera clock [us].
            advance_m: Least and most that the fingertip may have advanced at that time [m].
        """
        noise = self._noise**2
        if not self.known:
            self.known, self.force, self._ff, self._stamp_us = True, force_n, noise, stamp_us
            return
        seconds = min(max(1e-6 * (stamp_us - self._stamp_us), 0.0), 1.0)
        self._stamp_us = stamp_us
        self._ff += self._drift**2 * seconds
        low, high = advance_m
        x = self._advance = 0.5 * (low + high)
        # The advance is known to half the distance between both, two standard deviations of it.
        noise += (0.25 * (high - low) * self.bound) ** 2
        self._correct(force_n, x, noise)

    def largest_advance(self, force_n: float) -> float:
        """Return the advance at which the force stays below a given one, by its bound [m].

        Args:
            force_n: Force to stay below [N].

        The smallest A >= 0 with f + s k A + z sqrt(var(f + k A)) = F, s the reserve times how much
        a round contact stiffens on the way; 0 if there is none.
        """
        force = max(self.force, self._least[0])
        room = force_n - force
        slope = RESERVE * stiffening(force, force_n) * max(self.stiffness, 0.0)
        z2 = SIGMAS**2
        # (room - slope A)^2 = z^2 (ff + 2 A fk + A^2 kk), at slope A <= room.
        a = slope * slope - z2 * self._kk
        b = -2.0 * (room * slope + z2 * self._fk)
        c = room * room - z2 * self._ff
        root = math.sqrt(max(b * b - 4.0 * a * c, 0.0))
        q = -b + root
        # NaN allows nothing either.
        if not (room > 0.0 and c > 0.0) or math.isnan(q):
            return 0.0
        # The smaller positive root in the form that does not cancel; a may have any sign.
        return 2.0 * c / q if q > 0.0 else math.inf

    def _assume(self, variance: float) -> None:
        """Forget the stiffness: half the stiffest, its bound the stiffest."""
        self._least = (-math.inf, -math.inf, 0.0)
        self.stiffness = 0.5 * self._stiffest
        self._ff, self._fk = variance, 0.0
        self._kk = (self.stiffness / SIGMAS) ** 2

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
        self._kk = max(self._kk - gain_k * gain_k / variance, LEAST_STIFFNESS**2, self._least[2])
        self.stiffness = max(self.stiffness, self._least[1])


PRECISION: Final = 0.06
"""Relative standard deviation of the stiffness at which the probe returns."""
PROBE_S: Final = 0.15
"""Time after which the probe returns, whatever was learned [s]."""


class StiffnessProbe:
    """The wanted advance of the fingertip while the stiffness is probed.

    Args:
        parameters: How far and how fast.
        precision: Relative standard deviation of the stiffness that is good enough.
        longest_s: Time after which it returns, whatever was learned [s].

    Attributes:
        advance: Wanted advance of the probe [m].
        active: Whether it is under way.
        measured: Whether it has ended its measurement, and returns.
    """

    def __init__(
        self,
        parameters: SlipControlParameters,
        precision: float = PRECISION,
        longest_s: float = PROBE_S,
    ) -> None:
        self._parameters = parameters
        self._precision, self._longest_s = precision, longest_s
        self.advance = 0.0
        self.active = self.measured = False
        self._windows = 0

    def configure(self, parameters: SlipControlParameters) -> None:
        """Use other parameters from the next window on."""
        self._parameters = parameters

    def start(self) -> None:
        """Begin with the next window."""
        self.advance = 0.0
        self._windows, self.measured = 0, False
        self.active = self._parameters.probe_advance > 0.0

    def take_over(self) -> float:
        """End at once and return the advance reached [m]."""
        advance, self.advance, self.active = self.advance, 0.0, False
        return advance

    def update(self, stiffness: float, deviation: float, limit: float) -> None:
        """Go on by a window.

        Args:
            stiffness: Estimate so far [N/m].
            deviation: Its standard deviation [N/m].
            limit: Largest advance that the force allows [m].
        """
        if not self.active:
            return
        p = self._parameters
        step = p.probe_speed * p.window
        self._windows += 1
        if self.measured:
            self.advance = max(self.advance - step, 0.0)
            self.active = self.advance > 0.0
            return
        late = self._windows >= p.windows(self._longest_s)
        self.measured = late or deviation <= self._precision * stiffness
        waits = stiffness * self.advance >= p.probe_force
        self.advance = min(
            self.advance + (0.0 if waits else step), p.probe_advance, max(limit, 0.0)
        )


GAIN_SIGMAS: Final = 3.6
"""Standard deviations of the sensor's gain by which the upper bound of a force lies above it: in 48
simulated grasps of boxes, cups and balls by as many sensors, calibrated as in the bench, the true
force at rest was 3.6 and 2.8 of them above the measured one in two, and at most 2.5 in the others.
"""
CERTAIN_SIGMAS: Final = 3.0
"""Standard deviations below a measurement at which the force is sure to be as high."""
MOST_SHARE: Final = 0.5
"""Largest relative standard deviation that is believed of the gain."""
SHARE_FORCES: Final = 100
"""Forces of which the relative deviation is the mean, 0.2 s."""
GOAL_SHARE: Final = 0.9
"""Share of `max_force` up to which advances are planned."""
SOFT_SHARE: Final = 0.95
"""Share of `max_force` from which the arm advances no further, so as not to reach it."""


class AdvanceBound:
    """Decides how far the arm may advance.

    Args:
        parameters: Force ceiling, largest total, stiffness and probe.

    Attributes:
        stiffness: Estimate of the contact's stiffness.
        probe: The press that measures it.
    """

    def __init__(self, parameters: SlipControlParameters) -> None:
        self._parameters = parameters
        self.stiffness = ContactStiffness(parameters)
        self.probe = StiffnessProbe(parameters)
        self._share = 0.0
        self._shares = 0
        self._slipped = False

    @property
    def goal(self) -> float:
        """Force up to which advances are planned, as the sensor measures it [N]."""
        return GOAL_SHARE * self._parameters.max_force / (1.0 + GAIN_SIGMAS * self._share)

    def upper(
        self, force_n: float, deviation: float, advance_m: tuple[float, float], *, calm: bool
    ) -> float:
        """Return the upper bound of the normal force [N], by the sensor and by the advance.

        Args:
            force_n: What the sensor measures [N].
            deviation: Its standard deviation [N]; 0 of a force that is only noisy.
            advance_m: Least and most that the fingertip may have advanced at that time [m].
            calm: Whether there was no slip for a while: then the deviation is that of the gains.
        """
        if not deviation > 0.0:
            self._share = 0.0
            return force_n
        stiffness = self.stiffness
        if calm and not (self._slipped or self.probe.active) and stiffness.present > 0.0:
            share = min(deviation / max(stiffness.present, deviation), MOST_SHARE)
            self._shares += 1
            self._share += (share - self._share) / min(self._shares, SHARE_FORCES)
        x = 0.5 * (advance_m[0] + advance_m[1])
        expected = stiffness.force + stiffness.stiffness * x
        half = 0.5 * (advance_m[1] - advance_m[0]) * stiffness.bound
        spread = math.hypot(self._share * expected, half) + math.sqrt(stiffness.force_variance(x))
        weight = spread**2 / (spread**2 + deviation**2)
        both = expected + weight * (force_n - expected)
        high = both + GAIN_SIGMAS * math.sqrt(weight) * deviation
        return max(high, force_n - CERTAIN_SIGMAS * deviation)

    def configure(self, parameters: SlipControlParameters) -> None:
        """Use other parameters from the next window on."""
        self._parameters = parameters
        self.stiffness.configure(parameters)
        self.probe.configure(parameters)

    def start(self) -> tuple[float, float]:
        """Start over at advance zero; return the preload [N] and the largest advance [m].

        Raises:
            SlipControlError: The force leaves no room for an advance.
        """
        p = self._parameters
        self._slipped = False
        preload = self.stiffness.restart()
        limit = self.stiffness.largest_advance(self.goal)
        if limit <= 0.0:
            raise SlipControlError(
                f'the force is {preload:.2f} N already and max_force {p.max_force:.2f} N',
                remedy='lower the preload or raise max_force',
            )
        self.probe.start()
        return preload, min(limit, p.max_total)

    def on_slip(self) -> None:
        """Keep how well the gain of the sensor is known: of slip and what follows it tells less.

        The stiffness, which was learned with this gain, carries the force on from there.
        """
        self._slipped |= self._shares >= SHARE_FORCES

    def limit(self, reached: float, force_n: float | None) -> float:
        """Return the largest advance in this window [m].

        It is never below the advance already commanded, so that a noisy force makes the arm wait,
        not retreat.

        Args:
            reached: Advance commanded so far [m].
            force_n: Upper bound of the latest normal force [N], None before the first.
        """
        p = self._parameters
        if force_n is not None and force_n >= SOFT_SHARE * p.max_force:
            return reached
        largest = self.stiffness.largest_advance(self.goal)
        return max(min(largest, p.max_total), reached)
