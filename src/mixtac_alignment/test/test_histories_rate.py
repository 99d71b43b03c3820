# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The ring of event counts against a plain count."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixtac_alignment.errors import AlignmentError
from mixtac_alignment.histories import EventCounts, EventRateHistory

EPOCH_US = 1_700_000_000_000_000


@given(
    gaps=st.lists(st.sampled_from([0, 1, 400, 600, 5_000, 90_000]), min_size=1, max_size=80),
    cuts=st.lists(st.integers(0, 80), max_size=8),
    start=st.sampled_from([700, EPOCH_US + 321]),
)
def test_the_ring_holds_the_latest_complete_bins(
    gaps: list[int], cuts: list[int], start: int
) -> None:
    t = start + np.cumsum(gaps)
    history = EventRateHistory(span_s=0.05)
    borders = sorted(min(c, len(t)) for c in cuts)
    for a, b in zip([0, *borders], [*borders, len(t)], strict=True):
        if b > a:
            history.push(t[a:b], int(t[b - 1]))
    until = int(t[-1]) + 500
    history.push(t[:0], until)
    counts = history.snapshot()
    assert len(counts.counts) <= 100
    end = counts.start_us + 500 * len(counts.counts)
    assert until - 500 < end <= until
    expected = [int(np.sum((t >= at) & (t < at + 500))) for at in range(counts.start_us, end, 500)]
    assert counts.counts.tolist() == expected
    span = until - t[0]
    assert len(counts.counts) >= min(99, span // 500)


def test_a_restarted_clock_starts_over() -> None:
    history = EventRateHistory(span_s=1.0)
    history.push(np.array([50_000_000]), 50_000_500)
    history.push(np.array([1_000, 1_600]), 2_500)
    counts = history.snapshot()
    assert (history.restarts, counts.start_us, counts.counts.tolist()) == (1, 1000, [1, 1, 0])


def test_lost_packets_leave_a_mark_for_as_long_as_their_bins() -> None:
    history = EventRateHistory(span_s=0.05)
    history.push(np.array([10_000]), 12_000)
    history.mark_lost(15_000)
    history.push(np.array([15_100]), 20_000)
    counts = history.snapshot()
    assert counts.lost_near((12_000 - counts.start_us) // 500, 0)
    assert counts.lost_near((14_900 - counts.start_us) // 500, 0)
    assert not counts.lost_near((16_000 - counts.start_us) // 500, 0)
    assert counts.lost_near((16_000 - counts.start_us) // 500, 4)
    history.push(np.array([200_000]), 200_000)
    assert history.snapshot().lost == ()


def test_nothing_seen_is_nothing_counted() -> None:
    history = EventRateHistory(span_s=1.0)
    assert len(history.snapshot().counts) == 0


def test_counts_of_recorded_events() -> None:
    counts = EventCounts.of(np.array([10_000, 10_499, 10_500, 12_000]))
    assert (counts.start_us, counts.counts.tolist()) == (10_000, [2, 1, 0, 0, 1])
    with pytest.raises(AlignmentError):
        EventCounts.of(np.empty(0, np.int64))
