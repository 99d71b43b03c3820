# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
r"""The advance law: how far the arm shall advance along the contact normal.

Section Closed loop Slip Control of the paper: :math:`\Delta d_t = k\,(N_t - N_{th})`. Here k is
G / C, where C is events per metre of skin motion, so that G is a plain number: advance over motion
of the skin. Added are a memory, because an object that slides over a fully stretched skin causes no
more events (an excess is answered for some windows on while the slip lasts), a least answer where
a slip makes few, and what protects arm, gel and object: a limit per window, a limit of the sum,
a hold after each slip, and between slips a slow servo on the force, which takes back the advance
that is no longer needed and makes up for relaxation of the gel.

`Advance` combines the law with the bound of the advance (`bounds`) and with the planner, which
knows the commanded advance.
"""

from __future__ import annotations

import math
from typing import Final

from mixtac_slip_control.arm.planner import AdvancePlanner
from mixtac_slip_control.bounds import PRECISION, AdvanceBound
from mixtac_slip_control.detectors import Detectors
from mixtac_slip_control.grip import GripMargin
from mixtac_slip_control.parameters import SlipControlParameters


class AdvanceLaw:
    """Turns windows into a wanted advance, within limits that hold for every input.

    Args:
        parameters: Gain and limits.

    Attributes:
        total: Wanted advance since the last reset [m], 0 to the limit after each window.
    """

    def __init__(self, parameters: SlipControlParameters) -> None:
        self.configure(parameters)
        self.reset()

    def configure(self, parameters: SlipControlParameters) -> None:
        """Use other parameters from the next window on."""
        self._parameters = parameters
        self._per_event = parameters.gain / (1e3 * parameters.events_per_mm)
        windows = parameters.memory_time / parameters.window
        self._fade = math.exp(-1.0 / windows) if windows > 0.0 else 0.0

    def reset(self, preload: float | None = None) -> None:
        """Start over at the present position.

        Args:
            preload: Normal force to keep between slips [N]; None keeps none.
        """
        self.total = self._floor = 0.0
        self._preload = preload
        p = self._parameters
        self._speed, self._least = p.preload_speed, 0.0
        # There is no slip whose advance is to be held.
        self._held = p.windows(p.hold_time)
        self._excess = 0.0
        self._backing_off = self._raising = False

    def update(
        self, count: int, threshold: float, force: float | None, limit: float, *, slipping: bool
    ) -> float:
        """Return the advance of a window [m].

        It is negative only while backing off, or where the limit has fallen below the total.

        Args:
            count: Events in the window, N_t.
            threshold: N_th.
            force: Normal force [N], None where none is known.
            limit: Largest total [m].
            slipping: Whether the object slips.
        """
        before = self.total
        wanted = self._on_slip(count, threshold) if slipping else self._at_rest(force)
        self.total = min(max(before + wanted, 0.0), max(limit, 0.0))
        return self.total - before

    def aim(self, force: float, stiffness: float) -> None:
        """Keep another force between slips [N], on a contact of a stiffness [N/m]."""
        p = self._parameters
        self._preload = force
        self._speed = min(p.preload_rate / max(stiffness, 1.0), p.preload_speed)
        # Counts above the threshold of the paper's law are what it knows slip by.
        rate = p.slip_rate if p.detector == 'flow' else 0.0
        self._least = rate / max(stiffness, 1.0) * p.window

    def add(self, advance: float) -> None:
        """Take over an advance [m] >= 0 made for another reason."""
        self.total += max(advance, 0.0)

    def _on_slip(self, count: int, threshold: float) -> float:
        """Return the paper's advance; a return that led to slip is not repeated."""
        if self._backing_off:
            self._floor = self.total
            self._backing_off = False
        self._held = 0
        p = self._parameters
        self._excess = max(count - threshold, self._fade * self._excess, 0.0)
        return min(max(self._per_event * self._excess, self._least), p.max_step)

    def _at_rest(self, force: float | None) -> float:
        p = self._parameters
        self._excess = 0.0
        self._held += 1
        if self._held <= p.windows(p.hold_time) or force is None or self._preload is None:
            return 0.0
        excess = force - self._preload
        # Once it is raised, the force comes up to the preload, not to the edge of the band.
        self._raising = excess < (0.0 if self._raising else -p.force_band)
        if self._raising:
            return self._speed * p.window
        if excess > p.force_band and p.back_off > 0.0:
            room = self.total - self._floor
            self._backing_off = self._backing_off or room > 0.0
            return -min(p.back_off * p.window, max(room, 0.0))
        return 0.0


MAX_AGE_S: Final = 0.2
"""Older forces count as this old [s]: the planner does not remember advances for longer."""


class Advance:
    """Decides how far the arm shall be.

    Args:
        parameters: Of law and bound.
        planner: Knows the commanded advance.
        grip: Knows the force that the grasp needs.

    Attributes:
        bound: How far the arm may advance.
        limit: Largest advance in the latest window [m].
    """

    def __init__(
        self, parameters: SlipControlParameters, planner: AdvancePlanner, grip: GripMargin
    ) -> None:
        self._planner = planner
        self._law = AdvanceLaw(parameters)
        self.bound = AdvanceBound(parameters)
        self._grip = grip
        self.limit = self._preload = 0.0
        self._settles = False
        self._window: tuple[int, float] | None = None
        self.configure(parameters)

    @property
    def total(self) -> float:
        """Wanted advance since the start [m]."""
        return self._law.total + self.bound.probe.advance

    def configure(self, parameters: SlipControlParameters) -> None:
        """Use other parameters from the next window on."""
        self._lag_s, self._window_s = parameters.arm_lag, 1e-6 * parameters.window_us
        self._law.configure(parameters)
        self.bound.configure(parameters)

    def start(self) -> None:
        """Start over, with the planner at advance zero.

        Raises:
            SlipControlError: The force leaves no room for an advance.
        """
        self._settles = False
        self._preload, self.limit = self.bound.start()
        self._law.reset(self._preload)

    def on_window(self, end_us: int, now_s: float) -> None:
        """Record when a window that ends at `end_us` [us] of the camera clock arrived [s]."""
        self._window = (end_us, now_s)

    def on_force(
        self,
        force_n: float,
        stamp_us: int,
        now_s: float,
        deviation: float = 0.0,
        *,
        calm: bool = True,
    ) -> float:
        """Learn from what the sensor measures; return the upper bound of the normal force [N].

        Args:
            force_n: Normal force [N].
            stamp_us: Its time, camera clock [us].
            now_s: Host time of its arrival [s].
            deviation: Standard deviation of the force [N]; 0 of one that is only noisy.
            calm: Whether there was no slip for a while.
        """
        age = 0.0
        if self._window is not None:
            end_us, arrived_s = self._window
            age = now_s - arrived_s + 1e-6 * (end_us - stamp_us)
        at = now_s - min(max(age, 0.0), MAX_AGE_S)
        then = self._planner.advance_at(at), self._planner.advance_at(at - 2.0 * self._lag_s)
        reach = min(then), max(then)
        # A tactile sensor tells little of a fast press, and frames need some time to correct it.
        if calm or not deviation:
            self.bound.stiffness.on_force(force_n, stamp_us, reach)
        return self.bound.upper(force_n, deviation, reach, calm=calm)

    def commanded_motion(self, now_s: float) -> float:
        """Return how far the arm was commanded to move in the window that ends now [m]."""
        end = now_s - self._lag_s
        return self._planner.advance_at(end) - self._planner.advance_at(end - self._window_s)

    def update(
        self, count: int, detectors: Detectors, force_n: float | None, now_s: float
    ) -> float:
        """Return the change of the wanted advance by a window [m].

        Args:
            count: Events in the window.
            detectors: Their decision on it.
            force_n: Latest normal force [N], None before the first.
            now_s: Host time [s].
        """
        before = self.total
        stiffness, probe = self.bound.stiffness, self.bound.probe
        limit = self.bound.limit(self._planner.advance_at(now_s), force_n)
        if detectors.slipping:
            self.bound.on_slip()
            self._law.add(probe.take_over())
        probing, wanted = probe.active, self._grip.wanted(self._preload)
        probe.update(stiffness.stiffness, stiffness.deviation, limit - self._law.total)
        if probe.active and probe.measured and wanted > stiffness.present:
            # The margin needs this press anyway.
            self._law.add(probe.take_over())
        self._settles |= probing and not probe.active
        precise = stiffness.deviation <= PRECISION * stiffness.stiffness
        if self._settles and (precise or detectors.slipping):
            # Until then, what keeps or raises the force teaches more than the probe did.
            stiffness.settle()
            self._settles = False
        force = None if probe.active else stiffness.present
        self._law.aim(wanted, stiffness.stiffness)
        room = limit - probe.advance
        self._law.update(count, detectors.law_threshold, force, room, slipping=detectors.slipping)
        self.limit = max(limit, 0.0)
        return self.total - before
