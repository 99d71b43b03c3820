# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Each thing that stops, tripped alone."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import pytest

from mixtac_slip_control.errors import SlipControlError
from mixtac_slip_control.parameters import SlipControlParameters
from mixtac_slip_control.safety import Interlock, InterlockState, SafetyWatch

if TYPE_CHECKING:
    from collections.abc import Callable

PARAMETERS = SlipControlParameters()
NOW = 1_700_000_000.0
READY = (0.0, -0.8, 0.0, -2.3, 0.0, 1.6, 0.8)


def heard(now_s: float = NOW) -> SafetyWatch:
    watch = SafetyWatch(PARAMETERS, lambda q: 'joint 1 is at its end' if q[0] > 2.0 else None)
    watch.on_window(30, complete=True, now_s=now_s)
    watch.on_force(0.5, 1000, now_s)
    watch.on_joint_state(READY, now_s)
    watch.on_heartbeat(now_s)
    return watch


def test_with_everything_fresh_nothing_is_wrong() -> None:
    assert heard().fault(NOW + 0.01) is None


def refresh(watch: SafetyWatch, now_s: float, *, without: str) -> None:
    if without != 'events':
        watch.on_window(30, complete=True, now_s=now_s)
    if without != 'force':
        watch.on_force(0.5, round(now_s * 1e6), now_s)
    if without != 'joint states':
        watch.on_joint_state(READY, now_s)
    if without != 'heartbeat':
        watch.on_heartbeat(now_s)


@pytest.mark.parametrize(
    ('name', 'age'),
    [('events', 0.02), ('force', 0.05), ('joint states', 0.05), ('heartbeat', 0.5)],
)
def test_each_input_is_watched_by_its_own_age(name: str, age: float) -> None:
    watch = heard()
    refresh(watch, NOW + 0.9 * age, without=name)
    assert watch.fault(NOW + 0.9 * age) is None
    refresh(watch, NOW + 1.2 * age, without=name)
    assert name in str(watch.fault(NOW + 1.2 * age))


@pytest.mark.parametrize('name', ['events', 'force', 'joint states', 'heartbeat'])
def test_an_input_never_heard_of_stops(name: str) -> None:
    watch = SafetyWatch(PARAMETERS)
    refresh(watch, NOW, without=name)
    assert watch.fault(NOW) == f'no {name} so far'


def test_a_force_that_is_valid_again_may_be_followed() -> None:
    watch = heard()
    watch.on_quality('stale')
    assert watch.fault(NOW) is not None
    watch.on_quality('')
    assert watch.fault(NOW) is None


TRIPS: dict[str, Callable[[SafetyWatch], None]] = {
    'force is nan': lambda w: w.on_force(math.nan, 2000, NOW),
    'force is inf': lambda w: w.on_force(math.inf, 2000, NOW),
    'joint positions are': lambda w: w.on_joint_state((math.nan, *READY[1:]), NOW),
    'joint 1 is at its end': lambda w: w.on_joint_state((2.5, *READY[1:]), NOW),
    'not valid: light changed': lambda w: w.on_quality('light changed'),
    'above max_force': lambda w: w.on_force(1.6, 2000, NOW),
    'saturated': lambda w: [w.on_window(9000, complete=True, now_s=NOW) for _ in range(2)] and None,
    'missing': lambda w: [w.on_window(30, complete=False, now_s=NOW) for _ in range(5)] and None,
}


@pytest.mark.parametrize('reason', TRIPS)
def test_each_limit_trips(reason: str) -> None:
    watch = heard()
    TRIPS[reason](watch)
    assert reason in str(watch.fault(NOW))


def test_what_was_wrong_is_over_with_the_next_good_value() -> None:
    watch = heard()
    watch.on_force(math.nan, 2000, NOW)
    watch.on_joint_state((2.5, *READY[1:]), NOW)
    watch.on_force(0.5, 3000, NOW)
    watch.on_joint_state(READY, NOW)
    assert watch.fault(NOW) is None


def test_single_full_or_lost_windows_do_not_stop() -> None:
    watch = heard()
    watch.on_window(9000, complete=False, now_s=NOW)
    watch.on_window(30, complete=True, now_s=NOW)
    watch.on_window(9000, complete=True, now_s=NOW)
    assert watch.fault(NOW) is None


def test_a_force_that_is_repeated_grows_old() -> None:
    watch = heard()
    for k in range(10):
        watch.on_force(0.5, 1000, NOW + 0.01 * k)
    refresh(watch, NOW + 0.1, without='force')
    assert 'force' in str(watch.fault(NOW + 0.1))


@pytest.mark.parametrize('now', [NOW - 1.0, math.nan, math.inf])
def test_a_clock_that_jumps_stops(now: float) -> None:
    assert heard().fault(now) is not None


def test_only_a_new_force_is_news() -> None:
    watch = SafetyWatch(PARAMETERS)
    assert watch.on_force(0.5, 1000, NOW)
    assert not watch.on_force(0.5, 1000, NOW + 0.01)
    assert not watch.on_force(math.nan, 2000, NOW + 0.01)
    assert watch.on_force(0.6, 3000, NOW + 0.02)


def test_the_interlock_starts_disabled_and_latches_the_first_fault() -> None:
    lock = Interlock()
    assert lock.state is InterlockState.DISABLED
    lock.stop('while disabled')
    assert lock.state is InterlockState.DISABLED
    with pytest.raises(SlipControlError):
        lock.enable('no heartbeat so far')
    lock.enable(None)
    assert lock.enabled
    lock.stop('first')
    lock.stop('second')
    assert (lock.state, lock.reason) == (InterlockState.STOPPED, 'first')
    with pytest.raises(SlipControlError) as caught:
        lock.enable(None)
    assert 'reset' in caught.value.remedy
    lock.disable()
    assert lock.state is InterlockState.STOPPED
    lock.reset()
    assert lock.state is InterlockState.DISABLED
    lock.enable(None)
    lock.disable()
    assert lock.state is InterlockState.DISABLED
