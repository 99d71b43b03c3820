# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
r"""How far a grasp is from slipping, and the force that holds it with a margin.

The friction coefficient counts as the sensor measures it: pull over normal force at which the
object begins to slip. Its logarithm starts as a guess with a spread,
:math:`\ln \mu \sim N(m, s^2)`. Two things tell more:

* A slip: the pull that events tell of in its first milliseconds, over the normal force before it,
  is a measurement of :math:`\mu`. Wrong gains of the sensor count alike in both, so that the margin
  afterwards is better known than the coefficient.
* An object that does not slip: :math:`\mu` is above the largest ratio that held. The normal
  distribution is cut there, which moves its mean up and narrows it.

The margin is :math:`\mu` over the present ratio. `GripMargin.wanted` is the normal force at which
the margin would be `grip_margin`, were :math:`\mu` lower by two standard deviations, but not lower
than the ratio that held. It only ever raises the preload, up to `max_grip_force`.

The coefficient of the object itself is :math:`\mu` over the ratio of the gains of pull and normal
force, :math:`\ln g \sim N(0, \gamma^2)` with :math:`\gamma` = `GAIN_SPREAD`. Gains explain the
share :math:`\gamma^2 / s^2` of the difference between :math:`\ln \mu` and the guess, but never
more than :math:`\gamma`: a larger difference is one of the object.
"""

from __future__ import annotations

import math
from typing import Final

from mixtac_slip_control.parameters import SlipControlParameters

LEAST_NORMAL: Final = 0.05
"""Normal force from which on there is a ratio [N]."""
LEAST_PULL: Final = 0.03
"""Pull from which on there is a ratio [N]: an object that pulls at nothing needs no margin."""
FILTER_S: Final = 0.1
"""Time over which the forces of a grasp at rest are averaged [s]."""
SETTLE_S: Final = 0.4
"""Time at rest before what holds counts [s]: estimates take a few frames to settle."""
HELD_S: Final = 0.3
"""Time over which the ratio that holds is averaged [s]."""
LONGEST_US: Final = 20_000
"""Longer steps between two forces count as this long [us]."""
PEAK_US: Final = 8_000
"""Time from the begin of a slip in which its pull is looked for [us]: the arm has not answered."""
LATEST_US: Final = 1_000_000
"""A slip that lies farther ahead of a force is one of a clock that started anew since [us]."""
SLIP_SPREAD: Final = 0.12
"""Relative standard deviation of the coefficient that one slip tells."""
LEAST_SPREAD: Final = 0.06
"""Relative standard deviation below which it is never believed to be: surfaces are uneven."""
RATIO_SPREAD: Final = 0.05
"""Relative standard deviation of the ratio of an object at rest, gains aside."""
GAIN_SPREAD: Final = 0.15
"""Relative standard deviation of the measured ratio over the true one, by the gains of a calibrated
sensor under another shape, place and day: 0.15, 0.14 and 0.18 in 43 simulated grasps of boxes, cups
and balls."""
PULL_NOISE: Final = 0.03
"""Standard deviation of a small pull, as FGER-Net tells it where there is none [N]."""
SURE_SIGMAS: Final = 2.0
"""Standard deviations of the ratio by which the coefficient may lie lower than it is believed."""


def above(mean: float, spread: float, least: float) -> tuple[float, float]:
    """Return mean and standard deviation of a normal variable that is known to exceed a value.

    Args:
        mean: Mean without that knowledge.
        spread: Standard deviation without it, positive.
        least: What it exceeds.
    """
    a = (least - mean) / spread
    if a > 5.0:
        # All of what is left lies just above.
        return least + spread / a, spread / a
    tail = 0.5 * math.erfc(a / math.sqrt(2.0))
    hazard = math.exp(-0.5 * a * a) / (math.sqrt(2.0 * math.pi) * tail)
    return mean + spread * hazard, spread * math.sqrt(max(1.0 - hazard * (hazard - a), 1e-6))


class GripMargin:
    """Estimates friction coefficient and slip margin of a grasp, and the force that it needs.

    Args:
        parameters: Guess, wanted margin and limit.

    Attributes:
        normal: Normal force of the grasp at rest [N].
        pull: Sideways force at rest [N].
        slips: Slips that told about the coefficient since the start.
    """

    def __init__(self, parameters: SlipControlParameters) -> None:
        self._parameters = parameters
        self.start()

    def configure(self, parameters: SlipControlParameters) -> None:
        """Use other parameters; what was learned since the start stays."""
        self._parameters = parameters
        if not (self._held or self.slips):
            self._guess()

    def start(self) -> None:
        """Begin with another grasp: nothing is known of its friction."""
        self.normal = self.pull = 0.0
        self.slips = 0
        self._guess()
        self._held = self._ratio = self._rest_s = 0.0
        self._stamp_us: int | None = None
        self._slip_us: int | None = None
        self._peak = 0.0

    def _guess(self) -> None:
        p = self._parameters
        self._mean, self._variance = math.log(p.friction), p.friction_deviation**2

    @property
    def known(self) -> bool:
        """Whether the grasp pulls at the skin, so that there is a margin."""
        return self.normal > LEAST_NORMAL and self.pull > LEAST_PULL

    @property
    def measured_friction(self) -> tuple[float, float]:
        """Friction coefficient as the sensor measures it, and its relative standard deviation."""
        mean, spread = self._mean, math.sqrt(self._variance)
        if self._held > 0.0:
            mean, spread = above(mean, spread, math.log(self._held))
        return math.exp(mean), max(spread, LEAST_SPREAD)

    @property
    def friction(self) -> tuple[float, float]:
        """Friction coefficient of the object, and its relative standard deviation."""
        p = self._parameters
        measured, spread = self.measured_friction
        share = min((GAIN_SPREAD / p.friction_deviation) ** 2, 1.0)
        gain = share * math.log(measured / p.friction)
        within = math.sqrt(share * (1.0 - share)) * p.friction_deviation
        found = measured * math.exp(-min(max(gain, -GAIN_SPREAD), GAIN_SPREAD))
        return found, max(math.hypot(within, (1.0 - share) * spread), LEAST_SPREAD)

    @property
    def margin(self) -> tuple[float, float]:
        """Normal force over the smallest that holds, and its standard deviation.

        Both are infinite where nothing pulls at the skin.
        """
        if not self.known:
            return math.inf, math.inf
        friction, spread = self.measured_friction
        margin = friction * self.normal / self.pull
        return margin, margin * math.hypot(spread, RATIO_SPREAD, PULL_NOISE / self.pull)

    def on_force(self, normal: float, pull: float, stamp_us: int, *, still: bool) -> None:
        """Take what the sensor measures.

        Args:
            normal: Normal force [N].
            pull: Sideways force [N].
            stamp_us: Its time, camera clock [us].
            still: Whether the object and the arm have been at rest for a while.
        """
        if self._slip_us is not None:
            if stamp_us < self._slip_us - LATEST_US:
                self._slip_us = None  # the clock started anew
            elif stamp_us <= self._slip_us + PEAK_US:
                self._peak = max(self._peak, pull)
                return
            else:
                self._measure()
        before, self._stamp_us = self._stamp_us, stamp_us
        if not still:
            return
        if not self.normal:
            self.normal, self.pull = normal, pull
        seconds = 1e-6 * min(max(stamp_us - (before or stamp_us), 0), LONGEST_US)
        share = 1.0 - math.exp(-seconds / FILTER_S)
        self.normal += share * (normal - self.normal)
        self.pull += share * (pull - self.pull)
        self._rest_s += seconds
        if self.normal < LEAST_NORMAL:
            if self._held or self.slips:
                self.start()  # released: the next object is another one
            self._rest_s = self._ratio = 0.0
        if self.known and self._rest_s > SETTLE_S:
            now = self.pull / self.normal
            share = 1.0 - math.exp(-seconds / HELD_S)
            self._ratio = now if not self._ratio else self._ratio + share * (now - self._ratio)
            self._held = max(self._held, self._ratio)

    def on_slip(self, onset_us: int) -> None:
        """Note that a slip began, camera clock [us]."""
        if self._slip_us is None and self.known:
            self._slip_us, self._peak = onset_us, self.pull

    def wanted(self, preload: float) -> float:
        """Return the normal force that the grasp needs, not below a preload [N]."""
        p = self._parameters
        if not self.known or p.grip_margin <= 1.0:
            return preload
        friction, spread = self.measured_friction
        spread = math.hypot(spread, PULL_NOISE / self.pull)
        least = max(friction * math.exp(-SURE_SIGMAS * spread), self._held)
        needed = p.grip_margin * self.pull / least
        return max(preload, min(needed, p.max_grip_force))

    def figures(self) -> dict[str, float]:
        """Return the fields of `SlipStep` that tell of the grip."""
        friction, spread = self.friction
        margin, deviation = self.margin if self.known else (0.0, 0.0)
        return {
            'friction': friction,
            'friction_deviation': spread * friction,
            'margin': margin,
            'margin_deviation': deviation,
            'wanted_force': self.wanted(0.0),
        }

    def _measure(self) -> None:
        """Learn from the slip whose peak has been looked for."""
        self._slip_us = None
        self._rest_s = self._ratio = 0.0
        told = math.log(self._peak / self.normal)
        gain = self._variance / (self._variance + SLIP_SPREAD**2)
        self._mean += gain * (told - self._mean)
        self._variance *= 1.0 - gain
        # What held was as uncertain as what the slip told.
        self._held = min(self._held, math.exp(told))
        self.slips += 1


SETTLING: Final = 3.0
"""Times of rate and latency in which a gripper that is asked for a speed closes most of the gap: a
delayed loop of this pace does not swing."""


class GripperGoal:
    """What a gripper is asked for: a force that never falls while it holds, or a closing speed.

    A slip asks for `max_grip_force` while it lasts. A speed follows from the force that is missing,
    the stiffest contact that is plausible, and how late the gripper answers.

    Args:
        parameters: Kind, rate, latency and limits.
        grip: Knows the force that the grasp needs.
    """

    def __init__(self, parameters: SlipControlParameters, grip: GripMargin) -> None:
        self._grip = grip
        self.configure(parameters)
        self._sent_us: int | None = None
        self.start()

    def configure(self, parameters: SlipControlParameters) -> None:
        """Use other parameters from now on."""
        self._parameters = parameters

    def start(self) -> None:
        """Begin with another grasp."""
        self._goal = 0.0
        self._slipped = False

    def update(
        self, stamp_us: int, force_n: float | None, *, slipping: bool, trusted: bool
    ) -> float | None:
        """Return what to ask for now: force [N] or closing speed [m/s]; None for nothing new.

        Args:
            stamp_us: Camera clock [us].
            force_n: Normal force [N]; None before the first.
            slipping: Whether the object slips; a slip between two turns asks as well.
            trusted: Whether the force can be trusted: else a speed is zero and a force stays.
        """
        p, period_s = self._parameters, 1.0 / self._parameters.gripper_rate
        self._slipped |= slipping
        if self._sent_us is not None and 0 <= stamp_us - self._sent_us < 1e6 * period_s - 1.0:
            return None
        by_speed, slipped, self._slipped = p.gripper == 'speed', self._slipped, False
        if not trusted or force_n is None or not self._grip.normal > LEAST_NORMAL:
            if trusted:
                self.start()
            self._sent_us = stamp_us
            return 0.0 if by_speed else None
        self._sent_us = stamp_us
        wanted = p.max_grip_force if slipped else self._grip.wanted(self._grip.normal)
        self._goal = min(max(self._goal, wanted), p.max_grip_force)
        if not by_speed:
            return self._goal
        missing = self._goal - force_n
        if missing <= p.force_band:
            return 0.0
        pace_s = SETTLING * (p.gripper_latency + period_s)
        return min(missing / (p.stiffest_contact * pace_s), p.gripper_speed)
