# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The clock of a playback, against a clock that only the test moves."""

from __future__ import annotations

import threading

import pytest

from mixtac_driver.playback.player import PlaybackClock


class World:
    """A condition whose waits pass at once and take as long as they should."""

    def __init__(self, rate=1.0):
        self.now_s = 100.0
        self.waits = []
        self.at_wait = lambda: None
        self.clock = PlaybackClock(rate, now_s=lambda: self.now_s, changed=self)

    def __enter__(self):
        return self

    def __exit__(self, *error):
        pass

    def wait(self, timeout=None):
        self.at_wait()
        if timeout is not None:
            self.waits.append(timeout)
            self.now_s += timeout

    def notify_all(self):
        pass


@pytest.mark.parametrize('rate', [0.5, 1.0, 4.0])
def test_things_are_due_at_the_rate_from_the_first_on(rate):
    world = World(rate)
    for due_us in (5_000_000, 5_001_000, 5_500_000, 9_000_000):
        assert world.clock.wait_until(due_us)
        assert world.now_s == pytest.approx(100 + (due_us - 5_000_000) / 1e6 / rate)
    assert world.clock.lag.late_steps == 0


def test_as_fast_as_possible_never_waits():
    world = World(0.0)
    assert all(world.clock.wait_until(t) for t in range(0, 10**9, 10**7))
    assert not world.waits


def test_who_is_late_is_counted_and_not_given_more_time():
    world = World()
    world.clock.wait_until(0)
    world.now_s += 0.5
    for t in range(0, 400_000, 100_000):
        world.clock.wait_until(t)
    assert not world.waits
    assert world.clock.lag.late_steps == 4
    assert world.clock.lag.most_s == pytest.approx(0.5)
    assert world.clock.lag.now_s == pytest.approx(0.2)
    world.clock.wait_until(700_000)
    assert world.now_s == pytest.approx(100.7)
    assert world.clock.lag.now_s == 0


def test_a_pause_shifts_what_follows():
    world = World()
    world.clock.wait_until(0)
    world.clock.pause()
    assert world.clock.is_paused

    def go_on():
        world.now_s += 7
        world.at_wait = lambda: None
        world.clock.resume()

    world.at_wait = go_on
    assert world.clock.wait_until(1_000_000)
    assert world.now_s == pytest.approx(108)


def test_another_rate_counts_from_where_it_is():
    world = World()
    world.clock.wait_until(0)
    world.clock.wait_until(2_000_000)
    world.clock.set_rate(10)
    world.clock.wait_until(12_000_000)
    assert world.now_s == pytest.approx(103)


def test_interrupted_until_restarted():
    world = World()
    world.clock.interrupt()
    assert not world.clock.wait_until(0)
    world.clock.restart()
    assert world.clock.wait_until(10**12)
    assert not world.waits


def test_a_wait_in_progress_ends_when_interrupted():
    clock = PlaybackClock()
    assert clock.wait_until(0)
    results = []
    thread = threading.Thread(target=lambda: results.append(clock.wait_until(3600 * 10**6)))
    thread.start()
    clock.interrupt()
    thread.join(10)
    assert results == [False]
