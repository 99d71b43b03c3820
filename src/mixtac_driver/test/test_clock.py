# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Origins of the camera's clock over resets."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixtac_driver.clock import JUMP_US, ClockEpochs, Origin
from mixtac_driver.errors import StreamError

ASKED = Origin(10**15, 1000)


def test_new_stream_begins_after_what_was_published_before():
    epochs = ClockEpochs(ASKED, 1000, latest_us=ASKED.us + 400)
    origin = epochs.follow(1, 3, ASKED.host_ns + 6000)
    assert origin.us == ASKED.us + 401
    assert origin.uncertainty_ns == ASKED.uncertainty_ns + 401_000


@given(
    st.lists(st.tuples(st.integers(0, 10**6), st.booleans(), st.integers(-(10**9), 10**9))),
)
def test_published_time_never_goes_back(steps):
    epochs = ClockEpochs(ASKED, 1000)
    resets, time, host = 1, 0, ASKED.host_ns
    latest = -1
    for step, reset, jitter in steps:
        resets, time = (resets + 1, 0) if reset else (resets, time + step)
        host += 1000 * step
        arrival = host + abs(jitter) if resets == 1 else host + jitter
        try:
            origin = epochs.follow(resets, time, arrival)
        except StreamError:
            # Time that ran ahead of its arrival is not published.
            continue
        if origin is None:
            continue
        assert origin.us + time >= latest
        assert origin.host_ns % 1000 == 0
        latest = origin.us + time


def started():
    epochs = ClockEpochs(ASKED, 1000)
    epochs.follow(1, 0, ASKED.host_ns + 1000)
    return epochs


def test_a_reset_that_is_asked_for_later_has_its_measured_time():
    epochs = started()
    later = Origin(ASKED.host_ns + 10**9, 2000)
    epochs.ask(lambda: later)
    assert epochs.follow(1, 10**6 - 10, later.host_ns - 5000) == ASKED
    assert epochs.follow(2, 5, later.host_ns + 900_000) == later
    assert epochs.unasked == 0


def test_a_reset_under_way_before_another_was_asked_for_counts_as_unasked():
    epochs = started()
    later = Origin(ASKED.host_ns + 10**9, 2000)
    epochs.ask(lambda: later)
    assert epochs.follow(2, 5, later.host_ns - 500_000) != later
    assert epochs.unasked == 1
    assert epochs.follow(3, 5, later.host_ns + 500_000) == later


def test_data_that_arrive_before_the_request_returned_bound_the_reset():
    slow = Origin(ASKED.host_ns, 10_000_000)
    epochs = ClockEpochs(slow, 1000)
    origin = epochs.follow(1, 500, ASKED.host_ns - 1_500_000)
    # Between 10 ms and 2 ms before what was measured.
    assert origin == Origin(ASKED.host_ns - 6_000_000, 4_000_000)


@given(
    st.floats(-500e-6, 500e-6),
    st.lists(st.tuples(st.integers(0, 10**7), st.integers(0, 10**8)), max_size=200),
)
def test_late_data_and_slow_or_fast_clocks_are_no_jump(rate, steps):
    epochs, time_us = started(), 0
    for step_us, late_us in steps:
        time_us += step_us
        arrival_ns = ASKED.host_ns + 1000 * (time_us + late_us)
        assert epochs.follow(1, time_us + int(time_us * rate), arrival_ns) is not None


@given(st.integers(0, 10**12), st.integers(JUMP_US + 10_000, 10**15))
def test_data_from_the_future_are_a_jump(time_us, ahead_us):
    epochs = started()
    arrival_ns = ASKED.host_ns + 1000 * (time_us + 500)
    epochs.follow(1, time_us, arrival_ns)
    with pytest.raises(StreamError):
        epochs.follow(1, time_us + ahead_us, arrival_ns)
    epochs.follow(1, time_us + 100, arrival_ns)
