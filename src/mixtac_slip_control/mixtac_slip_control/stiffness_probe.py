# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A small press when slip control is enabled, from which the stiffness of the contact is learned.

Slip gives no time to learn it: the arm needs most of its advance within 20 ms, and a force that is
10 ms old says little of that. So the arm presses a little, slowly, waits until the stiffness is
known well enough, and returns.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from mixtac_slip_control.errors import SlipControlError


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
