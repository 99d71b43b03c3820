# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Interlock and watchdogs: the conditions under which the arm may respond to slip.

The interlock is off at start, on by request, and latches the first fault. The watch measures the
age of each input and checks the limits. Neither is a safety-rated function. People are protected by
the robot's own limits, its protective stop and the emergency stop.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from enum import IntEnum
from typing import Final

from mixtac_slip_control.arm.following import MAX_JOINT_AGE_S
from mixtac_slip_control.errors import SlipControlError
from mixtac_slip_control.features import SlipWindow
from mixtac_slip_control.parameters import PAPER, Current


class InterlockState(IntEnum):
    """State of the interlock; the numbers are those of `mixtac_msgs/SlipState`."""

    DISABLED = 0
    """Slip is reported, nothing moves."""
    ENABLED = 1
    """Slip moves the arm."""
    STOPPED = 2
    """A fault has stopped it; only a reset leads to DISABLED."""


class Interlock:
    """Latches the first fault.

    Attributes:
        state: Present state.
        reason: Why the interlock stopped; empty if it did not.
    """

    def __init__(self) -> None:
        self.state = InterlockState.DISABLED
        self.reason = ''

    @property
    def enabled(self) -> bool:
        """Whether the arm may respond to slip."""
        return self.state is InterlockState.ENABLED

    def enable(self, fault: str | None) -> None:
        """Enable the response of the arm to slip.

        Args:
            fault: Why the arm may not be enabled now, or None.

        Raises:
            SlipControlError: There is a fault, or a stop was not reset.
        """
        if self.state is InterlockState.STOPPED:
            raise SlipControlError(
                f'slip control is stopped ({self.reason})',
                remedy='remove the cause and call ~/reset',
            )
        if fault is not None:
            raise SlipControlError(f'slip control stays disabled: {fault}')
        self.state = InterlockState.ENABLED

    def disable(self) -> None:
        """Disable the response to slip; a stop remains."""
        if self.state is InterlockState.ENABLED:
            self.state = InterlockState.DISABLED

    def stop(self, reason: str) -> None:
        """Stop until a reset; the first reason is kept. Has no effect unless enabled."""
        if self.state is InterlockState.ENABLED:
            self.state = InterlockState.STOPPED
            self.reason = reason

    def reset(self) -> None:
        """Clear the stop; slip control stays disabled."""
        if self.state is InterlockState.STOPPED:
            self.state = InterlockState.DISABLED
        self.reason = ''


EVENTS: Final = 'events'
FORCE: Final = 'force'
JOINTS: Final = 'joint states'
HEARTBEAT: Final = 'heartbeat'
FRAMES: Final = 'frames'
MAX_AGE_S: Final = {
    EVENTS: 0.02,
    FORCE: 0.05,
    JOINTS: MAX_JOINT_AGE_S,
    HEARTBEAT: 0.5,
    FRAMES: 0.25,
}
"""Age of each input above which slip control stops [s]."""
MIN_CONTRAST: Final = 0.02
"""Smallest contrast of the picture at the contact in which the flow detector sees slip [1/px]: root
mean square gradient of the log intensity."""
MIN_FORCE: Final = 0.03
"""Mean force below which the contact counts as lost [N]."""
CONTACT_LOSS_S: Final = 0.05
"""Time over which the force is averaged for it [s]."""
SATURATION_COUNT: Final = 8000
"""Events in a window from which the sensor counts as saturated."""
SATURATED_WINDOWS: Final = 2
"""Saturated windows in a row that stop."""
LOST_WINDOWS: Final = 5
"""Windows in a row with lost packets that stop, or without a frame of their time."""
LIGHT_WINDOWS: Final = 200
"""Windows made by light, less the others, that stop: slip is not seen in them."""
ABSURD_FORCES: Final = 1e3
"""Force over `max_force` above which it is refused as a measurement."""
LATE_AGES: Final = 2.0
"""Delay of the events over its least from which they are late, over their largest age."""
FORGET_S: Final = 5.0
"""Time over which the least delay is forgotten [s]: the clocks of host and camera drift apart."""


class SafetyWatch:
    """Records the last arrival and the fault of each input.

    Every time is on one steady host clock [s]. A value that is not a number is rejected and counts
    as not received. Its fault is kept until a valid value arrives.

    Args:
        parameters: Returns law and largest force.
        check_state: Returns the fault of joint positions [rad], or None.

    Attributes:
        force: Latest normal force [N], None before the first.
        joints: Latest joint positions [rad], None before the first.
    """

    def __init__(
        self,
        parameters: Current,
        check_state: Callable[[Sequence[float]], str | None] = lambda _q: None,
    ) -> None:
        self._parameters = parameters
        self._check_state = check_state
        self.force: float | None = None
        self.joints: tuple[float, ...] | None = None
        self._arrived: dict[str, float] = {}
        self._wrong: dict[str, str] = {}
        self._saturated = self._lost = self._light = self._unguided = 0
        self._contrast = math.inf
        self._mean_force: float | None = None
        self._frame_us: int | None = None
        self._force_stamp_us: int | None = None
        self._end_us = -1
        self._least_s = self._late_s = 0.0
        self._untrusted = ''

    def on_window(self, window: SlipWindow, now_s: float) -> None:
        """Record a window that was closed now."""
        full = window.count >= SATURATION_COUNT
        self._saturated = self._saturated + 1 if full else 0
        self._lost = 0 if window.complete else self._lost + 1
        self._unguided = 0 if window.guided else self._unguided + 1
        self._light = min(max(self._light + (1 if window.light else -1), 0), LIGHT_WINDOWS)
        delay_s = now_s - 1e-6 * window.end_us
        forgotten = min(max(self.age(EVENTS, now_s) / FORGET_S, 0.0), 1.0)
        if window.end_us < self._end_us:
            forgotten = 1.0  # the clock of the camera started anew
        self._least_s = min(delay_s, self._least_s + forgotten * (delay_s - self._least_s))
        self._late_s, self._end_us = delay_s - self._least_s, window.end_us
        self._arrived[EVENTS] = now_s

    def on_frame(self, stamp_us: int, contrast: float, now_s: float) -> None:
        """Record a frame with its stamp, camera clock [us], and its contrast [1/px]."""
        if stamp_us == self._frame_us:
            return  # a repeated message shows nothing new
        self._frame_us, self._contrast = stamp_us, contrast
        self._arrived[FRAMES] = now_s

    def on_force(self, force_n: float, stamp_us: int, now_s: float) -> bool:
        """Record a force [N] and its stamp on the camera clock [us].

        Returns:
            Whether it is a new one.
        """
        if not abs(force_n) <= ABSURD_FORCES * self._parameters().max_force:
            self._wrong[FORCE] = f'force is {force_n} N'
            return False
        if self._force_stamp_us is not None and stamp_us == self._force_stamp_us:
            return False  # a repeated message shows no new measurement
        self._wrong.pop(FORCE, None)
        self._force_stamp_us = stamp_us
        self.force = force_n
        age = self.age(FORCE, now_s)
        self._arrived[FORCE] = now_s
        keep = math.exp(-max(age, 0.0) / CONTACT_LOSS_S)
        mean = force_n if self._mean_force is None else self._mean_force
        self._mean_force = force_n + keep * (mean - force_n)
        return True

    def on_quality(self, untrusted: str) -> None:
        """Record why the latest force cannot be trusted; empty if it can."""
        self._untrusted = untrusted

    def on_joint_state(self, positions: Sequence[float], stamp_s: float) -> None:
        """Record joint positions [rad] of a time [s]."""
        if not all(math.isfinite(q) for q in positions):
            self._wrong[JOINTS] = f'joint positions are {tuple(positions)}'
            return
        self.joints = tuple(float(q) for q in positions)
        self._arrived[JOINTS] = stamp_s
        reason = self._check_state(self.joints)
        if reason is None:
            self._wrong.pop(JOINTS, None)
        else:
            self._wrong[JOINTS] = reason

    def on_heartbeat(self, now_s: float) -> None:
        """Record a heartbeat of the supervisor."""
        self._arrived[HEARTBEAT] = now_s

    def age(self, name: str, now_s: float) -> float:
        """Return how long ago an input arrived [s], infinite before the first time."""
        arrived = self._arrived.get(name)
        return math.inf if arrived is None else now_s - arrived

    def trusts_force(self, now_s: float) -> bool:
        """Return whether the latest force is valid and not too old."""
        fresh = abs(self.age(FORCE, now_s)) <= MAX_AGE_S[FORCE]
        return fresh and not self._untrusted and FORCE not in self._wrong

    def fault(self, now_s: float) -> str | None:
        """Return why the arm may not respond to slip now, or None."""
        if self._untrusted:
            return f'the force is not valid: {self._untrusted}'
        return self._stale(now_s) or self._limits() or self._unseen()

    def _stale(self, now_s: float) -> str | None:
        if not math.isfinite(now_s):
            return f'the host time is {now_s}'
        for name, limit in MAX_AGE_S.items():
            if name == FRAMES and self._parameters().law == PAPER:
                continue
            if name in self._wrong:
                return self._wrong[name]
            age = self.age(name, now_s)
            if math.isinf(age):
                return f'no {name} so far'
            if not -limit <= age <= limit:
                return f'{name} {age * 1e3:.0f} ms old, {limit * 1e3:.0f} ms allowed'
        return self._behind()

    def _behind(self) -> str | None:
        """Return which inputs arrive, but too late, or None."""
        limit = LATE_AGES * MAX_AGE_S[EVENTS]
        if not self._late_s <= limit:
            return (
                f'events are taken {self._late_s * 1e3:.0f} ms late, {limit * 1e3:.0f} ms '
                'allowed: lower the load of this host'
            )
        apart_s = 1e-6 * (self._end_us - (self._force_stamp_us or 0))
        limit = MAX_AGE_S[FORCE] + MAX_AGE_S[EVENTS]
        if not abs(apart_s) <= limit:
            return (
                f'force and events are {abs(apart_s) * 1e3:.0f} ms apart, {limit * 1e3:.0f} ms '
                'allowed: the estimate is late, or its stamps are not of the clock of the camera'
            )
        return None

    def _limits(self) -> str | None:
        if self._saturated >= SATURATED_WINDOWS:
            return (
                f'the sensor is saturated: {SATURATION_COUNT} events or more in '
                f'{self._saturated} windows in a row'
            )
        if self._lost >= LOST_WINDOWS:
            return f'event packets are missing in {self._lost} windows in a row'
        if self._mean_force is not None and self._mean_force < MIN_FORCE:
            return (
                f'contact lost: the mean force of {self._mean_force:.2f} N is below '
                f'{MIN_FORCE:.2f} N'
            )
        most = self._parameters().max_force
        if self.force is not None and self.force > most:
            return f'force {self.force:.2f} N is above max_force {most:.2f} N'
        return None

    def _unseen(self) -> str | None:
        """Return why slip could not be detected, or None."""
        if self._parameters().law != PAPER:
            if self._unguided >= LOST_WINDOWS:
                return 'the latest frame is not of the time of the events, or of another size'
            if self._contrast < MIN_CONTRAST:
                return (
                    f'the picture at the contact has a contrast of {self._contrast:.3f} per px, '
                    f'below {MIN_CONTRAST:g}: slip cannot be seen in it'
                )
        if self._light >= LIGHT_WINDOWS:
            return 'the light changes all over the picture: slip cannot be seen'
        return None
