# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""How far the arm may advance: stiffness of the contact, the probe that measures it, the bound.

The force is bounded ahead, not watched: an arm that is 10 ms late has pressed several newtons too
hard before a measured force shows it. The bound is `ContactStiffness.largest_advance`, computed
anew in every window. It is never below the advance already commanded, so a noisy force makes the
arm wait, not retreat.

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
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from mixtac_slip_control.errors import SlipControlError

if TYPE_CHECKING:
    from mixtac_slip_control.arm.planner import Planner
    from mixtac_slip_control.detectors import SlipJudge
    from mixtac_slip_control.law import AdvanceLaw
    from mixtac_slip_control.safety import SafetyWatch


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


@dataclass(frozen=True, slots=True)
class ProbeSettings:
    """How far, how fast and how long is probed.

    Attributes:
        advance: Largest advance [m]; 0 does not probe.
        force: Growth of the force that is enough [N]: it then waits for the estimate.
        step: Advance per window, both ways [m].
        precision: Relative standard deviation of the stiffness that is good enough.
        windows: After so many windows it returns, whatever was learned.
    """

    advance: float = 5e-5
    force: float = 0.1
    step: float = 5e-7
    precision: float = 0.06
    windows: int = 150

    def __post_init__(self) -> None:
        """Refuse settings without a meaning.

        Raises:
            SlipControlError: An advance or time below zero, or a step or precision of zero.
        """
        numbers = (self.advance, self.force, self.step, self.precision)
        finite = all(math.isfinite(v) for v in numbers)
        if not finite or self.advance < 0.0 or self.windows < 0:
            raise SlipControlError(f'{self}: give finite numbers >= 0')
        if min(self.force, self.step, self.precision) <= 0.0:
            raise SlipControlError(f'{self}: force, step and precision must be above 0')


class StiffnessProbe:
    """Says where the fingertip shall be while it probes.

    Args:
        settings: How far, how fast and how long.

    Attributes:
        place: Wanted advance of the probe [m].
        active: Whether it is under way.
    """

    def __init__(self, settings: ProbeSettings | None = None) -> None:
        self.settings = settings or ProbeSettings()
        self.place = 0.0
        self.active = False
        self._windows = 0

    def start(self) -> None:
        """Begin with the next window."""
        self.place = 0.0
        self._windows = 0
        self.active = self.settings.advance > 0.0

    def end(self) -> float:
        """End at once and return where it was [m]."""
        place, self.place, self.active = self.place, 0.0, False
        return place

    def update(self, stiffness: float, deviation: float, limit: float) -> None:
        """Go on by a window.

        Args:
            stiffness: As estimated so far [N/m].
            deviation: Its standard deviation [N/m].
            limit: Largest advance that the force allows [m].
        """
        if not self.active:
            return
        settings = self.settings
        self._windows += 1
        known = deviation <= settings.precision * stiffness
        if known or self._windows > settings.windows:
            self._windows = settings.windows
            self.place = max(self.place - settings.step, 0.0)
            self.active = self.place > 0.0
            return
        step = settings.step if stiffness * self.place < settings.force else 0.0
        self.place = min(self.place + step, settings.advance, max(limit, 0.0))


GOAL_SHARE: Final = 0.9
"""Share of the force ceiling up to which advances are planned."""
MAX_AGE_S: Final = 0.2
"""A force older than this is taken as so old [s]; the planner remembers no longer."""


class Advancer:
    """Decides how far the arm shall be.

    Args:
        planner: Knows where the arm was told to be.
        law: Answers slip and keeps the preload.
        stiffness: Of the contact.
        probe: Learns it.
        arm_lag_s: From a commanded to the arm's true place [s].
    """

    def __init__(
        self,
        planner: Planner,
        law: AdvanceLaw,
        stiffness: ContactStiffness,
        probe: StiffnessProbe,
        arm_lag_s: float,
    ) -> None:
        self._planner = planner
        self._law = law
        self._stiffness = stiffness
        self._probe = probe
        self.arm_lag_s = arm_lag_s
        self._window: tuple[int, float] | None = None

    @property
    def total(self) -> float:
        """Wanted advance since the start [m]."""
        return self._law.total + self._probe.place

    @property
    def limit(self) -> float:
        """Largest advance at present [m]."""
        return self._law.limit + self._probe.place

    def start(self, max_force: float) -> None:
        """Start over with the planner at advance zero.

        Args:
            max_force: Force ceiling [N].

        Raises:
            SlipControlError: The force leaves no room for an advance.
        """
        preload = self._stiffness.restart()
        limit = self._stiffness.largest_advance(GOAL_SHARE * max_force)
        if limit <= 0.0:
            raise SlipControlError(
                f'the force is {preload:.2f} N already and max_force {max_force:.2f} N: lower the '
                'preload or raise max_force'
            )
        self._law.reset(limit, preload)
        self._probe.start()

    def on_window(self, end_us: int, now_s: float) -> None:
        """Take note of when a window that ends at `end_us` [us] of the camera clock was heard."""
        self._window = (end_us, now_s)

    def on_force(self, force_n: float, stamp_us: int, now_s: float) -> None:
        """Learn from a force [N]; its stamp on the camera clock [us], heard at `now_s` [s]."""
        age = 0.0
        if self._window is not None:
            end_us, heard_s = self._window
            age = now_s - heard_s + 1e-6 * (end_us - stamp_us)
        at = now_s - min(max(age, 0.0), MAX_AGE_S)
        then = self._planner.advance_at(at), self._planner.advance_at(at - 2.0 * self.arm_lag_s)
        self._stiffness.on_force(force_n, stamp_us, (min(then), max(then)))

    def moved(self, now_s: float, window_s: float) -> float:
        """Return how far the arm was told to move in the window that ends now [m]."""
        end = now_s - self.arm_lag_s
        return self._planner.advance_at(end) - self._planner.advance_at(end - window_s)

    def update(self, count: int, judge: SlipJudge, watch: SafetyWatch, now_s: float) -> float:
        """Return the change of the wanted advance by a window [m].

        Args:
            count: Events in the window.
            judge: What the detectors say of it.
            watch: Knows the force.
            now_s: Host time [s].
        """
        before, law = self.total, self._law
        reached = self._planner.advance_at(now_s)
        goal = GOAL_SHARE * watch.settings.max_force
        limit = max(self._stiffness.largest_advance(goal), reached)
        if watch.pressed:
            limit = reached
        if judge.slipping and self._probe.active:
            law.add(self._probe.end())
        self._probe.update(self._stiffness.stiffness, self._stiffness.deviation, limit - law.total)
        law.limit = max(min(limit - self._probe.place, law.settings.max_total), 0.0)
        force = None if self._probe.active else self._stiffness.present
        law.update(count, judge.law_threshold, force, slipping=judge.slipping)
        return self.total - before
