# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The wanted advance of each window: probe, law, and what the force allows.

The force is bounded ahead, not watched: an arm that is 10 ms late has pressed several newtons too
hard before a force says so. The bound is `ContactStiffness.largest_advance`, taken anew in every
window. It is never below where the arm was told to be already, so a noisy force makes it wait, not
retreat.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from mixtac_slip_control.errors import SlipControlError

if TYPE_CHECKING:
    from mixtac_slip_control.advance_law import AdvanceLaw
    from mixtac_slip_control.contact_stiffness import ContactStiffness
    from mixtac_slip_control.planner import Planner
    from mixtac_slip_control.safety import SafetyWatch
    from mixtac_slip_control.slip_judge import SlipJudge
    from mixtac_slip_control.stiffness_probe import StiffnessProbe

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
