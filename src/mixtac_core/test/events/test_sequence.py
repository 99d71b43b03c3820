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


def counted(numbers) -> SequenceCounter:
    counter = SequenceCounter()
    for number in numbers:
        counter.update(number)
    return counter


def test_the_first_message_may_have_any_number():
    counter = SequenceCounter()
    assert counter.update(5000) == 0
    assert (counter.received, counter.lost, counter.restarts) == (1, 0, 0)
    assert counter.continuous


def test_missing_numbers_are_lost_messages():
    counter = counted([7, 8])
    assert counter.update(12) == 3
    assert not counter.continuous
    assert counter.update(13) == 0
    assert counter.continuous
    assert (counter.received, counter.lost) == (4, 3)


def test_a_restart_of_the_sender_is_not_a_loss():
    counter = counted([100, 101, 0])
    assert not counter.continuous
    assert counter.update(1) == 0
    assert (counter.received, counter.lost, counter.restarts) == (4, 0, 1)


def test_a_far_jump_is_a_restart():
    counter = counted([3, 4 + RESTART_STEP])
    assert (counter.lost, counter.restarts) == (0, 1)


def test_a_repeated_message_counts_as_such():
    counter = counted([3, 4, 4, 5])
    assert (counter.received, counter.lost, counter.repeated, counter.restarts) == (3, 0, 1, 0)


@given(st.lists(st.integers(0, 2**64 - 1)))
def test_no_count_is_ever_negative(numbers):
    counter = SequenceCounter()
    assert all(0 <= counter.update(number) < RESTART_STEP for number in numbers)
    assert counter.received + counter.repeated == len(numbers)
    assert counter.lost >= 0


@given(st.sets(st.integers(0, 2000), min_size=1))
def test_received_and_lost_add_up_to_what_was_sent(numbers):
    kept = sorted(numbers)
    counter = counted(kept)
    assert counter.received + counter.lost == kept[-1] - kept[0] + 1


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
