# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The ring of force samples."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mixtac_alignment.histories import FINEST_NS, MOST_REFUSED, ForceHistory

SPAN_NS = 2_000_000_000


@given(
    steps=st.lists(st.integers(-3, 300_000_000), max_size=MOST_REFUSED + 1),
    capacity=st.integers(1, 10),
)
def test_the_ring_holds_the_latest_increasing_samples(steps: list[int], capacity: int) -> None:
    history = ForceHistory(span_s=2.0, capacity=capacity)
    kept: list[int] = []
    now = 1_700_000_000_000_000_000
    for i, step in enumerate(steps):
        now += step
        new = not kept or now >= kept[-1] + FINEST_NS
        assert history.push(now, (float(i), 0.0, now / 1e9)) == new
        if new:
            kept.append(now)
    t, force = history.snapshot('z')
    recent = [k for k in kept[-capacity:] if k >= kept[-1] - SPAN_NS]
    assert np.array_equal(t, np.array(recent, np.int64) / 1e9)
    assert np.array_equal(force, t)
    assert history.out_of_order == len(steps) - len(kept)
    full = [new for old, new in zip(kept, kept[capacity:], strict=False) if old >= new - SPAN_NS]
    assert history.dropped == len(full)


def test_a_restarted_clock_starts_over_and_no_number_is_dropped() -> None:
    history = ForceHistory(span_s=10.0, capacity=100)
    history.push(5_000_000_000, (1.0, 2.0, 3.0))
    for t_ns in (5_100_000_000, 100):
        assert not history.push(t_ns, (1.0, float('nan'), 3.0))
    assert (len(history.snapshot('x')[0]), history.out_of_order) == (1, 2)
    assert history.push(100, (4.0, 5.0, 6.0))
    t, force = history.snapshot('y')
    assert (t.tolist(), force.tolist(), history.restarts) == ([1e-7], [5.0], 1)


def test_a_small_step_back_for_good_is_a_restart() -> None:
    history = ForceHistory(span_s=10.0, capacity=100)
    history.push(5_000_000_000, (1.0, 2.0, 3.0))
    taken = [history.push(4_400_000_000 + 1000 * k, (float(k), 0.0, 0.0)) for k in range(30)]
    assert taken == [False] * MOST_REFUSED + [True] * (30 - MOST_REFUSED)
    assert history.restarts == 1
    assert history.snapshot('x')[1][0] == MOST_REFUSED


def test_stamps_of_zero_and_coarse_stamps_are_no_restart() -> None:
    history = ForceHistory(span_s=10.0, capacity=100)
    for tick in range(1, 5):
        taken = [history.push(5_000_000_000 + 16_000_000 * tick, (1.0, 2.0, 3.0))]
        taken += [
            history.push(5_000_000_000 + 16_000_000 * tick, (1.0, 2.0, 3.0)) for _ in range(112)
        ]
        assert taken == [True] + [False] * 112
        assert not history.push(0, (1.0, 2.0, 3.0))
    assert (len(history.snapshot('x')[0]), history.restarts) == (4, 0)


def test_stamps_that_are_one_in_seconds_are_one_sample() -> None:
    history = ForceHistory(span_s=10.0, capacity=100)
    first_ns = 1_700_000_000_000_000_000
    taken = [history.push(first_ns + 100 * k, (1.0, 2.0, 3.0)) for k in range(21)]
    assert taken == ([True] + [False] * 9) * 2 + [True]
    assert np.all(np.diff(history.snapshot('x')[0]) > 0.0)
