# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Each thing that stops, tripped alone."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import pytest

from mixtac_slip_control.errors import SlipControlError
from mixtac_slip_control.parameters import SlipControlParameters
from mixtac_slip_control.safety import LIGHT_WINDOWS, Interlock, InterlockState, SafetyWatch

from .slip_windows import window

if TYPE_CHECKING:
    from collections.abc import Callable

    from mixtac_slip_control.features import SlipWindow

PARAMETERS = SlipControlParameters()
NOW = 1_700_000_000.0
NOW_US = 1_700_000_000_000_000
READY = (0.0, -0.8, 0.0, -2.3, 0.0, 1.6, 0.8)


def ending(time_s: float, **changes: Any) -> SlipWindow:
    """Return a window that ends at a time [s] of the camera clock."""
    return window(round(1e3 * time_s) - 1, **changes)


def heard(now_s: float = NOW) -> SafetyWatch:
    watch = SafetyWatch(
        lambda: PARAMETERS, lambda q: 'joint 1 is at its end' if q[0] > 2.0 else None
    )
    watch.on_window(ending(now_s), now_s)
    watch.on_frame(1000, 0.1, now_s)
    watch.on_force(0.5, NOW_US, now_s)
    watch.on_joint_state(READY, now_s)
    watch.on_heartbeat(now_s)
    return watch


def test_with_everything_fresh_nothing_is_wrong() -> None:
    assert heard().fault(NOW + 0.01) is None


def refresh(watch: SafetyWatch, now_s: float, *, without: str) -> None:
    if without != 'events':
        watch.on_window(ending(now_s), now_s)
    if without != 'frames':
        watch.on_frame(round(now_s * 1e6), 0.1, now_s)
    if without != 'force':
        watch.on_force(0.5, round(now_s * 1e6), now_s)
    if without != 'joint states':
        watch.on_joint_state(READY, now_s)
    if without != 'heartbeat':
        watch.on_heartbeat(now_s)


@pytest.mark.parametrize(
    ('name', 'age'),
    [
        ('events', 0.02),
        ('frames', 0.25),
        ('force', 0.05),
        ('joint states', 0.05),
        ('heartbeat', 0.5),
    ],
)
def test_each_input_is_watched_by_its_own_age(name: str, age: float) -> None:
    watch = heard()
    refresh(watch, NOW + 0.9 * age, without=name)
    assert watch.fault(NOW + 0.9 * age) is None
    refresh(watch, NOW + 1.2 * age, without=name)
    assert name in str(watch.fault(NOW + 1.2 * age))


@pytest.mark.parametrize('name', ['events', 'frames', 'force', 'joint states', 'heartbeat'])
def test_an_input_that_never_arrived_stops(name: str) -> None:
    watch = SafetyWatch(lambda: PARAMETERS)
    refresh(watch, NOW, without=name)
    assert watch.fault(NOW) == f'no {name} so far'


def repeat(watch: SafetyWatch, times: int, **changes: Any) -> None:
    for _ in range(times):
        watch.on_window(ending(NOW, **changes), NOW)


def lose(watch: SafetyWatch, force_n: float) -> None:
    for ms in range(500):
        refresh(watch, NOW + 1e-3 * ms, without='force')
        watch.on_force(force_n, NOW_US + 1000 * ms, NOW + 1e-3 * ms)
    refresh(watch, NOW, without='force')
    watch.on_force(force_n, NOW_US, NOW)


TRIPS: dict[str, Callable[[SafetyWatch], None]] = {
    'force is nan': lambda w: w.on_force(math.nan, NOW_US + 1000, NOW),
    'force is 1.7e+308': lambda w: w.on_force(1.7e308, NOW_US + 1000, NOW),
    'force is inf': lambda w: w.on_force(math.inf, NOW_US + 1000, NOW),
    'joint positions are': lambda w: w.on_joint_state((math.nan, *READY[1:]), NOW),
    'joint 1 is at its end': lambda w: w.on_joint_state((2.5, *READY[1:]), NOW),
    'not valid: light changed': lambda w: w.on_quality('light changed'),
    'above max_force': lambda w: w.on_force(1.6, NOW_US + 1000, NOW),
    'saturated': lambda w: repeat(w, 2, count=9000),
    'missing': lambda w: repeat(w, 5, complete=False),
    'frame is not of the time': lambda w: repeat(w, 5, guided=False),
    'light': lambda w: repeat(w, LIGHT_WINDOWS, light=True),
    'contrast': lambda w: w.on_frame(2000, 0.01, NOW),
    'contact lost': lambda w: lose(w, 0.0),
    'mean force of -3': lambda w: lose(w, -3.0),
}


@pytest.mark.parametrize('reason', TRIPS)
def test_each_limit_trips(reason: str) -> None:
    watch = heard()
    TRIPS[reason](watch)
    assert reason in str(watch.fault(NOW))


def test_what_was_wrong_is_over_with_the_next_good_value() -> None:
    watch = heard()
    watch.on_force(math.nan, NOW_US + 1000, NOW)
    watch.on_joint_state((2.5, *READY[1:]), NOW)
    watch.on_force(0.5, NOW_US + 2000, NOW)
    watch.on_joint_state(READY, NOW)
    assert watch.fault(NOW) is None


def test_by_counts_no_frames_are_needed() -> None:
    watch = SafetyWatch(lambda: SlipControlParameters(law='paper'))
    refresh(watch, NOW, without='frames')
    repeat(watch, 9, guided=False)
    assert watch.fault(NOW) is None


def test_joint_states_are_as_old_as_their_stamps() -> None:
    watch = heard()
    for stamp_s in (NOW - 10.0, NOW + 10.0):
        watch.on_joint_state(READY, stamp_s)
        assert 'joint states' in str(watch.fault(NOW))


def test_a_force_that_is_repeated_grows_old() -> None:
    watch = heard()
    for k in range(10):
        watch.on_force(0.5, 1000, NOW + 0.01 * k)
    refresh(watch, NOW + 0.1, without='force')
    assert 'force' in str(watch.fault(NOW + 0.1))


@pytest.mark.parametrize('now', [NOW - 1.0, math.nan, math.inf])
def test_a_clock_that_jumps_stops(now: float) -> None:
    assert heard().fault(now) is not None


def fed(watch: SafetyWatch, delays_s: list[float], drift: float = 1.0) -> list[str | None]:
    """Let a window end each millisecond and arrive with a delay; return what is wrong each time."""
    found = []
    for ms, delay_s in enumerate(delays_s):
        end_s = NOW + 1e-3 * ms
        now_s = NOW + 1e-3 * ms * drift + delay_s
        refresh(watch, now_s, without='events')
        watch.on_window(ending(end_s), now_s)
        watch.on_force(0.5, round(1e6 * end_s), now_s)
        found.append(watch.fault(now_s))
    return found


def test_events_that_fall_behind_stop_although_they_come_regularly() -> None:
    watch = heard()
    found = fed(watch, [3e-4 * ms for ms in range(300)])
    assert found[:100] == [None] * 100
    assert 'events' in str(found[-1])
    # Under way they were caught up with, and then the camera was started anew.
    assert fed(watch, [0.0] * 10)[-1] is None


@pytest.mark.parametrize('offset_s', [-1e9, -0.5, 0.0, 3e3])
@pytest.mark.parametrize('drift', [1.0 - 5e-4, 1.0, 1.0 + 5e-4])
def test_neither_clocks_apart_nor_a_host_that_catches_up_are_late_events(
    drift: float, offset_s: float
) -> None:
    busy = [max(1e-3 * (18 - 2 * (ms % 500)), 1e-3) for ms in range(20_000)]
    found = fed(SafetyWatch(lambda: PARAMETERS), [offset_s + delay for delay in busy], drift)
    assert set(found) == {None}


@pytest.mark.parametrize('seconds', [-5.0, -0.08, 0.08, 5.0])
def test_a_force_of_another_time_than_the_events_stops(seconds: float) -> None:
    watch = heard()
    watch.on_force(0.5, NOW_US + round(1e6 * seconds), NOW)
    assert 'force' in str(watch.fault(NOW))
    watch.on_force(0.5, NOW_US + round(0.5e6 * math.copysign(0.08, seconds)), NOW)
    assert watch.fault(NOW) is None


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
