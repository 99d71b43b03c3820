# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Origins of the camera's clock over resets."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from mixtac_driver.clock_epochs import ClockEpochs
from mixtac_driver.sequences import Origin

ASKED = Origin(10**15, 1000)


def test_reset_that_arrived_before_it_was_asked_for_is_another():
    epochs = ClockEpochs(ASKED, 1000)
    assert epochs.follow(1, 50, ASKED.host_ns - 5000) is None
    assert epochs.follow(1, 60, ASKED.host_ns + 5000) is None
    assert epochs.follow(2, 3, ASKED.host_ns + 6000) == ASKED
    assert epochs.unasked == 0


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
        origin = epochs.follow(resets, time, host + abs(jitter) if resets == 1 else host + jitter)
        if origin is None:
            continue
        assert origin.us + time >= latest
        assert origin.host_ns % 1000 == 0
        latest = origin.us + time
