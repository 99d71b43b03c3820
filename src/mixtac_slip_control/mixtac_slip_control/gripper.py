# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Commands for a gripper: the force to hold, or a closing speed."""

from __future__ import annotations

from typing import Final

from mixtac_slip_control.law import BAND, STIFFEST
from mixtac_slip_control.parameters import SlipControlParameters

PERIOD_S: Final = 0.05
"""Time between two commands [s]."""
LATENCY_S: Final = 0.05
"""Time from a command to the response of the fingers [s]."""
SETTLING: Final = 3.0
"""Times of period and latency in which a speed closes most of the gap: a delayed loop of this pace
does not swing."""
FASTEST: Final = 5e-3
"""Largest closing speed that is asked for [m/s]."""
HELD_N: Final = 0.05
"""Force from which on an object counts as held [N]."""
SETTLED_S: Final = 0.4
"""Time for which it is held before its force counts as that of the grasp [s]."""


class GripperGoal:
    """Computes a force that never falls while an object is held, or the speed that reaches it.

    The force is `grip_margin` times the force of the grasp; a slip raises it to `slip_force`. A
    speed follows from the missing force, the stiffest plausible contact, and the latency of the
    gripper.
    """

    def __init__(self) -> None:
        self._sent_us: int | None = None
        self.start()

    def start(self) -> None:
        """Begin with another grasp."""
        self._grasp = self._goal = 0.0
        self._held_us: int | None = None
        self._slipped = False

    def update(
        self,
        stamp_us: int,
        force_n: float | None,
        p: SlipControlParameters,
        *,
        slipping: bool,
        trusted: bool,
    ) -> float | None:
        """Return the command now: force [N] or closing speed [m/s]; None for nothing new.

        Args:
            stamp_us: Camera clock [us].
            force_n: Normal force [N]; None before the first.
            p: Kind of command, ratios and forces.
            slipping: Whether the object slips; a slip between two commands counts as well.
            trusted: Whether the force can be trusted: else a speed is zero and a force stays.
        """
        self._slipped |= slipping
        if self._sent_us is not None and 0 <= stamp_us - self._sent_us < 1e6 * PERIOD_S - 1.0:
            return None
        self._sent_us = stamp_us
        by_speed, slipped, self._slipped = p.gripper == 'speed', self._slipped, False
        if not trusted or force_n is None or not force_n > HELD_N:
            if trusted:
                self.start()
            return 0.0 if by_speed else None
        if self._held_us is None or stamp_us < self._held_us:
            self._held_us = stamp_us
        if not self._grasp and stamp_us - self._held_us >= 1e6 * SETTLED_S:
            self._grasp = force_n
        answer = p.answer_force(self._grasp)
        wanted = answer if slipped else min(p.grip_margin * self._grasp, answer)
        self._goal = max(self._goal, wanted)
        if not by_speed:
            return self._goal or None
        missing = self._goal - force_n
        pace_s = SETTLING * (LATENCY_S + PERIOD_S)
        return 0.0 if missing <= BAND * self._goal else min(missing / (STIFFEST * pace_s), FASTEST)
