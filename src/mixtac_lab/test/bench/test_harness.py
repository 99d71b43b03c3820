# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Ages and losses, told from packets whose true times are known."""

from __future__ import annotations

import numpy as np
import pytest

from mixtac_events.arrays import Events
from mixtac_lab.bench.harness import Arrivals
from mixtac_lab.bench.pattern import make_pattern

ORIGIN_US = 1_760_000_000_000_000


@pytest.fixture(scope='module')
def pattern():
    return make_pattern(100_000, wraps=2)


def packets(pattern, periods, origin_error_us):
    """Yield (seq, events as a driver stamps them, true end of the cell [us])."""
    events = pattern.events
    t = np.concatenate([events.t + k * pattern.period_us for k in range(periods)])
    x, y, p = (np.tile(a, periods) for a in (events.x, events.y, events.polarity))
    ends = range(1000, periods * pattern.period_us, 1000)
    for seq, end in enumerate(ends):
        a, b = np.searchsorted(t, (end - 1000, end))
        stamped = t[a:b] + ORIGIN_US + origin_error_us
        yield seq, Events(stamped, x[a:b], y[a:b], p[a:b]), ORIGIN_US + end


def arrivals(pattern):
    return Arrivals(ORIGIN_US * 1000, pattern.period_us, len(pattern.events))


@pytest.mark.parametrize('origin_error_us', [-3000, 0, 170])
def test_ages_are_true_whatever_the_driver_believes_of_the_origin(pattern, origin_error_us):
    probe = arrivals(pattern)
    for seq, events, end_us in packets(pattern, 6, origin_error_us):
        probe.add(seq, events, (end_us + 400) * 1000)
    figures = probe.summary()
    assert figures['origin_error_us'] == origin_error_us
    # Uniform over the millisecond of the cell, and 0.4 ms of way.
    assert figures['age_p50_ms'] == pytest.approx(0.9, abs=0.03)
    assert figures['age_max_ms'] == pytest.approx(1.4, abs=0.01)
    assert (figures['events_lost'], figures['packets_lost'], figures['backwards']) == (0, 0, 0)
    assert figures['periods'] == 5


def test_a_lost_packet_is_counted_with_its_events(pattern):
    probe = arrivals(pattern)
    lost = 0
    for seq, events, end_us in packets(pattern, 6, 0):
        if seq in (100, 101):
            lost += len(events)
        else:
            probe.add(seq, events, end_us * 1000)
    figures = probe.summary()
    assert figures['packets_lost'] == 2
    assert figures['events_lost'] == lost > 0


def test_events_lost_inside_packets_are_counted(pattern):
    probe = arrivals(pattern)
    for seq, events, end_us in packets(pattern, 6, 0):
        probe.add(seq, events[1:] if seq == 100 else events, end_us * 1000)
    assert probe.summary()['events_lost'] == 1


def test_no_packets_give_no_ages(pattern):
    figures = arrivals(pattern).summary()
    assert figures['periods'] == figures['events'] == 0
    assert np.isnan(figures['age_p50_ms'])


def test_a_restart_of_the_driver_is_not_a_loss(pattern):
    probe = arrivals(pattern)
    for seq, events, end_us in packets(pattern, 2, 0):
        probe.add(seq % 50, events, end_us * 1000)
    assert probe.summary()['packets_lost'] == 0
