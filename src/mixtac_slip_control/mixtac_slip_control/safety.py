# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Interlock and watchdogs: when the arm may follow slip.

The interlock is off at start, on by request, and latches the first fault. The watch knows how old
each input is and which limits hold. Neither is a safety-rated function: the robot's own limits, its
protective stop and the emergency stop remain what keeps people safe.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import IntEnum
from typing import TYPE_CHECKING, Final

from mixtac_slip_control.errors import SlipControlError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence


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
        reason: Why it stopped; empty unless it did.
    """

    def __init__(self) -> None:
        self.state = InterlockState.DISABLED
        self.reason = ''

    @property
    def enabled(self) -> bool:
        """Whether the arm may follow slip."""
        return self.state is InterlockState.ENABLED

    def enable(self, fault: str | None) -> None:
        """Let the arm follow slip.

        Args:
            fault: What speaks against it now, or None.

        Raises:
            SlipControlError: Something does, or it is stopped and was not reset.
        """
        if self.state is InterlockState.STOPPED:
            raise SlipControlError(
                f'slip control is stopped ({self.reason}): remove the cause and call ~/reset'
            )
        if fault is not None:
            raise SlipControlError(f'slip control stays disabled: {fault}')
        self.state = InterlockState.ENABLED

    def disable(self) -> None:
        """Let nothing move; a stop stays a stop."""
        if self.state is InterlockState.ENABLED:
            self.state = InterlockState.DISABLED

    def stop(self, reason: str) -> None:
        """Stop for good; the first reason is kept. Without effect unless enabled."""
        if self.state is InterlockState.ENABLED:
            self.state = InterlockState.STOPPED
            self.reason = reason

    def reset(self) -> None:
        """Leave the stop; the arm stays disabled."""
        if self.state is InterlockState.STOPPED:
            self.state = InterlockState.DISABLED
        self.reason = ''


EVENTS: Final = 'events'
FORCE: Final = 'force'
JOINTS: Final = 'joint states'
HEARTBEAT: Final = 'heartbeat'
SOFT_SHARE: Final = 0.95
"""Share of the force ceiling from which the arm advances no further, so as not to reach it."""


@dataclass(frozen=True, slots=True)
class SafetySettings:
    """Limits and ages; a reason to stop is one that they do not hold.

    Attributes:
        max_events_age: Age of the latest event packet [s].
        max_force_age: Age of the latest force [s].
        max_joint_age: Age of the latest joint states [s].
        max_heartbeat_age: Age of the latest heartbeat [s].
        max_force: Force ceiling [N].
        saturation_count: Events per window from which the sensor is saturated.
        saturation_windows: Saturated windows in a row that stop.
        max_lost_windows: Windows in a row with lost packets that stop.
    """

    max_events_age: float = 0.02
    max_force_age: float = 0.05
    max_joint_age: float = 0.05
    max_heartbeat_age: float = 0.5
    max_force: float = 1.5
    saturation_count: int = 8000
    saturation_windows: int = 2
    max_lost_windows: int = 5

    def __post_init__(self) -> None:
        """Refuse settings that watch nothing.

        Raises:
            SlipControlError: An age, force, stiffness or number that is not positive.
        """
        positive = (
            self.max_events_age,
            self.max_force_age,
            self.max_joint_age,
            self.max_heartbeat_age,
            self.max_force,
            float(self.saturation_count),
            float(self.saturation_windows),
            float(self.max_lost_windows),
        )
        if not all(math.isfinite(v) and v > 0.0 for v in positive):
            raise SlipControlError(f'safety settings {positive}: give positive finite numbers')


@dataclass(slots=True)
class SafetyWatch:
    """Remembers when each input was heard of and what was wrong with it.

    Every time is on one steady host clock [s]. A value that is not a number is refused and counts
    as not heard of; what is wrong with the latest one stays on record until a good one comes.

    Attributes:
        settings: Limits and ages.
        check_state: Tells what is wrong with joint positions [rad], None if nothing is.
        force: Latest normal force [N], None before the first.
        joints: Latest joint positions [rad], None before the first.
    """

    settings: SafetySettings = field(default_factory=SafetySettings)
    check_state: Callable[[Sequence[float]], str | None] = lambda _q: None
    force: float | None = None
    joints: tuple[float, ...] | None = None
    _heard: dict[str, float] = field(default_factory=dict)
    _wrong: dict[str, str] = field(default_factory=dict)
    _saturated: int = 0
    _lost: int = 0
    _force_stamp_us: int | None = None

    def on_window(self, count: int, *, complete: bool, now_s: float) -> None:
        """Take note of a window that was closed now."""
        self._saturated = self._saturated + 1 if count >= self.settings.saturation_count else 0
        self._lost = 0 if complete else self._lost + 1
        self._heard[EVENTS] = now_s

    def on_force(self, force_n: float, stamp_us: int, now_s: float) -> bool:
        """Take note of a force [N] with its stamp, camera clock [us]; return whether it is news."""
        if not math.isfinite(force_n):
            self._wrong[FORCE] = f'force is {force_n}'
            return False
        if self._force_stamp_us is not None and stamp_us == self._force_stamp_us:
            return False  # the same value again says nothing of now
        self._wrong.pop(FORCE, None)
        self._force_stamp_us = stamp_us
        self.force = force_n
        self._heard[FORCE] = now_s
        return True

    def on_joint_state(self, positions: Sequence[float], now_s: float) -> None:
        """Take note of joint positions [rad]."""
        if not all(math.isfinite(q) for q in positions):
            self._wrong[JOINTS] = f'joint positions are {tuple(positions)}'
            return
        self.joints = tuple(float(q) for q in positions)
        self._heard[JOINTS] = now_s
        reason = self.check_state(self.joints)
        if reason is None:
            self._wrong.pop(JOINTS, None)
        else:
            self._wrong[JOINTS] = reason

    def on_heartbeat(self, now_s: float) -> None:
        """Take note of a sign of life of whoever supervises."""
        self._heard[HEARTBEAT] = now_s

    @property
    def pressed(self) -> bool:
        """Whether the force is so near its ceiling that the arm may advance no further."""
        return self.force is not None and self.force >= SOFT_SHARE * self.settings.max_force

    def age(self, name: str, now_s: float) -> float:
        """Return how long ago an input was heard of [s], infinite before the first time."""
        heard = self._heard.get(name)
        return math.inf if heard is None else now_s - heard

    def fault(self, now_s: float) -> str | None:
        """Return why the arm may not follow slip now, or None."""
        return self._stale(now_s) or self._limits()

    def _stale(self, now_s: float) -> str | None:
        settings = self.settings
        if not math.isfinite(now_s):
            return f'the host time is {now_s}'
        allowed = (
            (EVENTS, settings.max_events_age),
            (FORCE, settings.max_force_age),
            (JOINTS, settings.max_joint_age),
            (HEARTBEAT, settings.max_heartbeat_age),
        )
        for name, limit in allowed:
            if name in self._wrong:
                return self._wrong[name]
            age = self.age(name, now_s)
            if math.isinf(age):
                return f'no {name} so far'
            if not -limit <= age <= limit:
                return f'{name} {age * 1e3:.0f} ms old, {limit * 1e3:.0f} ms allowed'
        return None

    def _limits(self) -> str | None:
        settings = self.settings
        if self._saturated >= settings.saturation_windows:
            return (
                f'the sensor is saturated: {settings.saturation_count} events or more in '
                f'{self._saturated} windows in a row'
            )
        if self._lost >= settings.max_lost_windows:
            return f'event packets are missing in {self._lost} windows in a row'
        if self.force is not None and self.force > settings.max_force:
            return f'force {self.force:.2f} N is above max_force {settings.max_force:.2f} N'
        return None
