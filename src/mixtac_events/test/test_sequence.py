# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Counting lost messages by their numbers."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from mixtac_events.sequence import RESTART_STEP, SequenceCounter


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
