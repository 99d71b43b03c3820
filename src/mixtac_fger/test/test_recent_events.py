# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The latest windows, and what is known again: against lists that forget nothing."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from mixtac_events.arrays import Events
from mixtac_fger.recent_events import KEPT_US, Known, RecentWindows, bin_of, inverse_of, packed


def events(seed: int, count: int) -> Events:
    random = np.random.default_rng(seed)
    return Events(
        np.sort(random.integers(0, 2000, count)),
        random.integers(0, 346, count).astype(np.uint16),
        random.integers(0, 260, count).astype(np.uint16),
        random.random(count) < 0.5,
    )


@settings(max_examples=20, deadline=None)
@given(
    st.lists(st.integers(0, 40), min_size=1, max_size=1200),
    st.integers(1, KEPT_US // 2000),
    st.integers(0, 5000),
)
def test_the_latest_windows_are_as_they_came(numbers, count, large):
    numbers[len(numbers) // 2] = large
    windows, all_of_them = RecentWindows(2000), []
    for index, number in enumerate(numbers):
        window = events(index, number)
        windows.add(2000 * (index + 1), window)
        all_of_them.append(window[: windows.most])
    count = min(count, len(numbers))
    assert windows.numbers[-count:] == numbers[-count:]
    found = windows.events(windows.latest(count))
    assert np.array_equal(found, packed(Events.concatenate(all_of_them[-count:])))
    end_us = 2000 * len(numbers)
    assert windows.between(end_us - 2000 * count, end_us) == windows.latest(count)
    assert windows.between(end_us, end_us + 1).start == windows.latest(0).stop
    windows.clear()
    assert windows.numbers == windows.ends_us == []


COORDINATE = st.integers(0, 2**16 - 1)


@given(st.lists(st.tuples(st.integers(-(2**40), 2**60), COORDINATE, COORDINATE, st.booleans())))
def test_a_packed_event_holds_all_of_it(rows):
    t, x, y, polarity = (np.array([row[k] for row in rows]) for k in range(4))
    fields = t.astype(np.int64), x.astype(np.uint16), y.astype(np.uint16), polarity.astype(bool)
    expected = [
        (each[0] % 2**31) * 2**33 + each[2] * 2**17 + each[1] * 2 + each[3] for each in rows
    ]
    assert [int(each) % 2**64 for each in packed(Events(*fields))] == expected


@given(COORDINATE, st.integers(1, 500))
def test_a_bin_is_a_quotient(coordinate, size):
    assert bin_of(coordinate, inverse_of(size)) == coordinate // size


@given(st.lists(st.frozensets(st.integers(0, 20), max_size=5), max_size=60), st.integers(1, 8))
def test_what_was_among_the_latest_is_known(groups, most):
    known = Known(most, 5)
    for index, group in enumerate(groups):
        before = frozenset().union(*groups[max(index - most, 0) : index])
        assert known.add(np.array([*group], np.uint64)) == len(group & before)
