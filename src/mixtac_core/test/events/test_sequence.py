# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Lost messages by their numbers, and stretches of time that no packet covered."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixtac_core.events.sequence import (
    BACKWARD_US,
    JUMP_US,
    LONG_HOLE_US,
    RESTART_STEP,
    Arrival,
    SequenceCounter,
    StreamTime,
)


@pytest.mark.parametrize(
    ('numbers', 'lost', 'repeated', 'restarts', 'continuous'),
    [
        ([5000], 0, 0, 0, True),
        ([7, 8, 12], 3, 0, 0, False),
        ([7, 8, 12, 13], 3, 0, 0, True),
        ([100, 101, 0], 0, 0, 1, False),
        ([3, 4 + RESTART_STEP], 0, 0, 1, False),
        ([3, 4, 4, 5], 0, 1, 0, True),
    ],
)
def test_missing_numbers_are_lost_messages(numbers, lost, repeated, restarts, continuous):
    counter = SequenceCounter()
    assert sum(map(counter.update, numbers)) == lost
    assert counter.received == len(numbers) - repeated
    assert (counter.lost, counter.repeated, counter.restarts) == (lost, repeated, restarts)
    assert counter.continuous == continuous


@given(st.lists(st.integers(0, 2**64 - 1)))
def test_no_count_is_ever_negative(numbers):
    counter = SequenceCounter()
    assert all(0 <= counter.update(number) < RESTART_STEP for number in numbers)
    assert counter.received + counter.repeated == len(numbers)
    assert counter.lost >= 0


@pytest.mark.parametrize(
    ('step_us', 'lost', 'expected'),
    [
        (1000, False, Arrival.CONTINUES),
        (1000, True, Arrival.AFTER_HOLE),
        (0, True, Arrival.CONTINUES),
        (LONG_HOLE_US, True, Arrival.AFTER_HOLE),
        (LONG_HOLE_US + 1, True, Arrival.STARTS),
        (JUMP_US, False, Arrival.CONTINUES),
        (JUMP_US + 1, False, Arrival.STARTS),
        (-BACKWARD_US - 2000, False, Arrival.STARTS),
    ],
)
def test_a_packet_continues_a_stream_or_starts_one(step_us, lost, expected):
    time = StreamTime()
    assert time.push(5_000_000, 5_001_000, lost_before=False) is Arrival.STARTS
    first = 5_001_000 + step_us
    assert time.push(first, first + 1000, lost_before=lost) is expected
    assert time.newest_us == max(first + 1000, 5_001_000 if step_us >= 0 else 0)
    assert (time.gaps, time.restarts) == (
        expected is not Arrival.CONTINUES and step_us > 0,
        step_us < -BACKWARD_US,
    )


@given(st.integers(0, 20), st.integers(1, 20))
def test_a_window_is_covered_as_far_as_no_hole_is_in_it(before, hole):
    time = StreamTime()
    time.push(0, 10_000 + 1000 * before, lost_before=False)
    begin = 10_000 + 1000 * before
    end = begin + 1000 * hole
    time.push(end, end + 100_000, lost_before=True)
    for window_end in range(12_000, end + 50_000, 2000):
        missing = sum(begin <= t < end for t in range(window_end - 2000, window_end))
        assert time.covered(window_end, 2000) == (missing < 2000, missing == 0)
