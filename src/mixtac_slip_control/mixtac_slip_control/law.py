# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
r"""The advance laws: they compute how far the arm advances along the contact normal.

`paper_advance` is the law of the paper (section Closed loop Slip Control): in a window with
:math:`N_t > N_{th}` the arm advances by :math:`\Delta d_t = k\,(N_t - N_{th})`.

`StepLaw` presses at enabling until the force is `grip_margin` times the force at enabling; gains of
the sensor cancel in this ratio. On the way it learns the stiffness of the contact by least squares.
At a slip it advances by one bounded step, holds, and returns slowly to the press.

`AdvanceLaw.update` limits the advance of every law to `max_total`, and to the advance at which the
usable force would be reached at the upper bound of the stiffness.
"""

from __future__ import annotations

import math
from enum import Enum, auto
from typing import Final

from mixtac_slip_control.errors import SlipControlError
from mixtac_slip_control.parameters import PAPER, WINDOW_S, Current

STIFFEST: Final = 1e4
"""Stiffest plausible contact [N/m]: the bound before anything was measured. Gel and mesh alone,
under a rigid flat face of 24 mm, came to 8.4e3 N/m in the stiffest of 40 simulated sensors."""
PRIOR: Final = 5e3
"""Stiffness before anything was measured [N/m]."""
PRIOR_SD: Final = 2.5e3
"""Its standard deviation [N/m]: two of them reach the stiffest."""
FORCE_SD: Final = 0.03
"""Standard deviation of a force at rest [N]."""
SIGMAS: Final = 2.0
"""Standard deviations by which the bound of the stiffness lies above its estimate."""
RESERVE: Final = 1.25
"""Stiffness of a fast step over that of a slow press, in which the gel relaxes."""
PRECISE: Final = 0.1
"""Relative standard deviation of the stiffness from which it counts as measured."""
LARGEST_RATIO: Final = 20.0
"""Largest ratio of two forces for which a contact stiffens."""
LEAST_RISE: Final = 1.05
"""Least usable force over the force of the grasp; with less room, no slip could be held."""
DRIFT: Final = 2e-6
"""Variance by which the force at advance zero may change from one force to the next [N^2], as the
gel relaxes and as the sensor corrects the force of a fast press."""


def stiffening(from_n: float, to_n: float) -> float:
    """Return the mean stiffness between two forces [N] over that at the first, under a sphere.

    Hertz: F ~ x^(3/2). Flat contacts stiffen less.
    """
    ratio = min(to_n / max(from_n, 1e-3), LARGEST_RATIO)
    return (ratio - 1.0) / (1.5 * (ratio ** (2.0 / 3.0) - 1.0)) if ratio > 1.0 + 1e-6 else 1.0


class Contact:
    """Model f + k x of the contact force over the advance x, fitted by recursive least squares.

    Attributes:
        force: f, force at advance zero [N].
        stiffness: k [N/m].
        present: Expected force at the advance of the latest measured one [N].
        place: Latest advance without slip at which the force was measured [m].
        seen: Number of forces used.
        precise: Whether the stiffness was measured well since the latest restart.
    """

    def __init__(self) -> None:
        self.force = self.present = self.place = 0.0
        self.seen = 0
        self.restart(0.0)

    def restart(self, advance: float) -> None:
        """Make an advance the new zero, and reset the stiffness."""
        if self.seen:
            self.force = self.at(advance)
        self.stiffness, self.place, self.precise = PRIOR, 0.0, False
        self._ff, self._fk, self._kk = FORCE_SD**2, 0.0, PRIOR_SD**2

    @property
    def deviation(self) -> float:
        """Standard deviation of the stiffness [N/m]."""
        return math.sqrt(self._kk)

    @property
    def bound(self) -> float:
        """Upper bound of the stiffness [N/m]."""
        return max(min(RESERVE * self.stiffness + SIGMAS * self.deviation, STIFFEST), 1.0)

    def at(self, advance: float) -> float:
        """Return the expected force [N] at an advance [m]."""
        return self.force + self.stiffness * advance

    def reach(self, force_n: float) -> float:
        """Return the advance that is safe for a force [N], counted from `place` [m]."""
        now_n = self.at(self.place)
        return self.place + (force_n - now_n) / (self.bound * stiffening(now_n, force_n))

    def on_force(self, force_n: float, advance: float, spread: float) -> None:
        """Use a force.

        Args:
            force_n: Normal force [N].
            advance: Advance of the arm at its time [m].
            spread: Standard deviation of that advance [m].
        """
        if not self.seen:
            self.force = force_n
        self.seen += 1
        residual = force_n - self.at(advance)
        self._ff += DRIFT
        noise = FORCE_SD**2 + (spread * self.bound) ** 2
        by_f, by_k = self._ff + advance * self._fk, self._fk + advance * self._kk
        variance = by_f + advance * by_k + noise
        self.force += by_f / variance * residual
        self.stiffness = max(self.stiffness + by_k / variance * residual, 1.0)
        self.present = self.at(advance)
        # Rounding must not make a variance negative.
        self._ff = max(self._ff - by_f**2 / variance, 1e-8)
        self._fk -= by_f * by_k / variance
        self._kk = max(self._kk - by_k**2 / variance, 1.0)
        self.precise |= self.deviation <= PRECISE * self.stiffness


def paper_advance(count: int, threshold: float, gain: float) -> float:
    """Return the advance of a window by the law of the paper [m].

    Args:
        count: N_t, events in the window.
        threshold: N_th.
        gain: k [m].
    """
    return gain * (count - threshold) if count > threshold else 0.0


class Phase(Enum):
    """The phases of `StepLaw`."""

    PRESS = auto()
    """Presses towards `grip_margin`, and learns the stiffness."""
    KEEP = auto()
    """Keeps the force of the press."""
    SLIP = auto()
    """Answers a slip."""
    HOLD = auto()
    """Completes the response as the stiffness becomes known, and holds it."""
    RETURN = auto()
    """Returns to the force of the press."""


PRESS_RATE: Final = 1.5
"""Rate of the force while pressing [N/s], by the stiffness as it is known. The measured force lags
behind that of a faster press, which then ends too late."""
SLOWEST_PRESS: Final = 2e-4
"""Least speed of the press [m/s]."""
FASTEST_PRESS: Final = 1e-3
"""Largest speed of the press [m/s]."""
LONGEST_PRESS_S: Final = 1.0
"""Time after which the press ends, whatever it has reached [s]."""
KEEP_RATE: Final = 0.5
"""Rate at which a force that has fallen is restored [N/s]."""
FASTEST_KEEP: Final = 5e-4
"""Largest speed of that advance [m/s]."""
BAND: Final = 0.04
"""Share by which the force may fall below the goal before it is restored."""
HOLD_S: Final = 0.3
"""Time without slip for which the response is held [s]."""
RETURN_SPEED: Final = 2e-5
"""Speed of the return [m/s]."""


class StepLaw:
    """Presses in advance, responds to a slip with one bounded step, holds, and returns.

    Args:
        goal: Force of the press [N].

    Attributes:
        phase: Present phase.
        goal: Force of the press [N].
    """

    def __init__(self, goal: float) -> None:
        self.goal = goal
        self._windows = 0
        self._floor = 0.0
        self._raising = False
        self.phase = Phase.PRESS

    def advance(self, total: float, contact: Contact, *, slipping: bool) -> float:
        """Return the wanted advance since enabling [m]; infinite for as far as the bound allows.

        Args:
            total: Wanted advance so far [m].
            contact: Force and stiffness.
            slipping: Whether the object slips.
        """
        phase = self._next(slipping, contact.present, total)
        if phase is not self.phase:
            if phase is Phase.SLIP and self.phase is Phase.RETURN:
                self._floor = total  # a return that led to a slip is not repeated
            self.phase, self._windows = phase, 0
        self._windows += 1
        if phase in {Phase.SLIP, Phase.HOLD}:
            # An object that slides over a stretched skin is no longer detected.
            return math.inf
        if phase is Phase.PRESS:
            speed = PRESS_RATE / contact.stiffness
            return total + WINDOW_S * min(max(speed, SLOWEST_PRESS), FASTEST_PRESS)
        if phase is Phase.KEEP:
            # Once the force is raised, it comes up to the goal, not to the edge of the band.
            edge = self.goal if self._raising else (1.0 - BAND) * self.goal
            self._raising = contact.present < edge
            speed = min(KEEP_RATE / contact.stiffness, FASTEST_KEEP) if self._raising else 0.0
            return total + WINDOW_S * speed
        return max(total - WINDOW_S * RETURN_SPEED, min(self._floor, total))

    def _next(self, slipping: bool, force: float, total: float) -> Phase:
        if slipping:
            return Phase.SLIP
        elapsed_s = self._windows * WINDOW_S
        if self.phase is Phase.SLIP:
            return Phase.HOLD
        if self.phase is Phase.PRESS and (force >= self.goal or elapsed_s >= LONGEST_PRESS_S):
            return Phase.KEEP
        if self.phase is Phase.HOLD and elapsed_s >= HOLD_S:
            return Phase.RETURN
        if self.phase is Phase.RETURN and (force <= self.goal or total <= self._floor):
            return Phase.KEEP
        return self.phase


class AdvanceLaw:
    """Computes the wanted advance by the chosen law, and limits it by the force.

    Args:
        parameters: Returns law, ratios and limits.

    Attributes:
        contact: Force and stiffness of the contact.
        total: Wanted advance since enabling [m].
        limit: Largest advance in the latest window [m].
        usable: Force up to which the arm presses since enabling [N].
        step: The law `step`.
    """

    def __init__(self, parameters: Current) -> None:
        self._parameters = parameters
        self.contact = Contact()
        self.total = self.limit = self.usable = 0.0
        self.step = StepLaw(0.0)

    def start(self, advance: float) -> None:
        """Start over at advance zero.

        Args:
            advance: Advance that the arm has at present, from the start before [m].

        Raises:
            SlipControlError: The force leaves no room for an advance.
        """
        p = self._parameters()
        self.contact.restart(advance)
        force = self.contact.force
        if LEAST_RISE * force > p.usable_force:
            raise SlipControlError(
                f'the force is {force:.2f} N already, and slip control may use '
                f'{p.usable_force:.2f} N (force_share {p.force_share:g} of max_force '
                f'{p.max_force:g} N): too little more to hold a slip',
                remedy='grasp less firmly, or raise max_force or force_share',
            )
        self.total = self.limit = 0.0
        self.usable = p.usable_force if p.law == PAPER else p.answer_force(force)
        self.step = StepLaw(min(p.grip_margin * force, self.usable))

    def on_force(
        self, force_n: float, advance: float, spread: float, *, calm: bool, enabled: bool
    ) -> None:
        """Learn the contact from a force.

        Args:
            force_n: Normal force [N].
            advance: Advance of the arm at its time [m].
            spread: Standard deviation of that advance [m].
            calm: Whether there was no slip for a while. Forces of a slip do not change a contact
                that was measured well: a tactile sensor underestimates the force of a fast press.
            enabled: Whether the arm may move.
        """
        if calm or (enabled and not self.contact.precise):
            self.contact.on_force(force_n, advance, spread)
        if calm:
            self.contact.place = advance

    def update(
        self, count: int, threshold: float, advance: float, force: float, *, slipping: bool
    ) -> float:
        """Return the change of the wanted advance by a window [m].

        Args:
            count: Events in the window.
            threshold: N_th of the paper's law.
            advance: Advance that is commanded now [m].
            force: Latest measured normal force [N].
            slipping: Whether the object slips.
        """
        p, before = self._parameters(), self.total
        if p.law == PAPER:
            wanted = before + paper_advance(count, threshold, p.gain)
        else:
            wanted = self.step.advance(before, self.contact, slipping=slipping)
        # The bound makes the arm wait, not retreat: a noisy force must not move it.
        reach = self.contact.reach(self.usable) if force < self.usable else advance
        self.limit = max(min(reach, p.max_total), min(before, p.max_total), 0.0)
        self.total = min(max(wanted, 0.0), self.limit)
        return self.total - before
