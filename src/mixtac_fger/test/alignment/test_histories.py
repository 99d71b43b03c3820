# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What is remembered of events, frames and force, in bounded memory."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixtac_core.events.arrays import Events
from mixtac_core.events.packets import DecodedPacket
from mixtac_fger.alignment.histories import (
    BATCH,
    FRAMES_PER_S,
    EventHistory,
    ForceHistory,
    FrameHistory,
    by_cell,
    reduce_frame,
)

SIZE = (346, 260)
EPOCH_US = 1_700_000_000_000_000
SPAN_NS = 2_000_000_000


def events_at(t_us) -> Events:
    t_us = np.asarray(t_us, np.int64)
    zero = np.zeros(len(t_us), np.uint16)
    return Events(t_us, zero, zero, np.ones(len(t_us), np.bool_))


def add(history: EventHistory, t_us, until_us: int, seq: int) -> bool:
    return history.add(DecodedPacket(events_at(t_us), until_us), seq, *SIZE)


@given(
    gaps=st.lists(st.sampled_from([0, 1, 400, 600, 5_000, 90_000]), min_size=1, max_size=80),
    cuts=st.lists(st.integers(0, 80), max_size=8),
    start=st.sampled_from([700, EPOCH_US + 321]),
)
def test_counts_are_those_of_the_latest_complete_bins(
    gaps: list[int], cuts: list[int], start: int
) -> None:
    t = start + np.cumsum(gaps)
    history = EventHistory(span_s=0.05)
    borders = sorted({min(c, len(t)) for c in cuts} - {0, len(t)})
    for seq, (a, b) in enumerate(zip([0, *borders], [*borders, len(t)], strict=True)):
        assert not add(history, t[a:b], int(t[b - 1]), seq)
    until = int(t[-1]) + 500
    add(history, [], until, len(borders) + 1)
    counts = history.counts()
    assert len(counts.counts) <= 100
    end = counts.start_us + 500 * len(counts.counts)
    assert until - 500 < end <= until + 500
    expected = [int(np.sum((t >= at) & (t < at + 500))) for at in range(counts.start_us, end, 500)]
    assert counts.counts.tolist() == expected
    assert len(counts.counts) >= min(99, (until - t[0]) // 500)


def test_batches_hold_every_event_and_mark_what_was_lost() -> None:
    random, lost = np.random.default_rng(3), 2 * BATCH
    history, kept = EventHistory(60.0), []
    for seq in range(3 * BATCH):
        start_us = 1_000_000 + 1000 * seq
        n = int(random.integers(1, 30))
        t_us = np.sort(random.integers(start_us, start_us + 1000, n))
        columns = random.integers(0, 346, n).astype(np.uint16)
        rows = random.integers(0, 260, n).astype(np.uint16)
        part = Events(t_us, columns, rows, random.random(n) < 0.5)
        if seq != lost:
            kept.append(part)
            assert not history.add(DecodedPacket(part, start_us + 1000), seq, *SIZE)
    every = Events.concatenate(kept)
    found, counts = history.events(), history.counts()
    assert found.t_us.tolist() == every.t.tolist()
    assert found.on.tolist() == every.polarity.tolist()
    assert found.cell.tolist() == by_cell(every, *SIZE).cell.tolist()
    assert counts.counts.sum() == len(every)
    place = (1_000_000 + 1000 * lost - counts.start_us) // counts.width_us
    assert counts.lost_near(place, 0)
    assert not counts.lost_near(place - 10, 0)
    assert counts.lost_near(place - 10, 12)
    assert history.packets.lost == 1


@pytest.mark.parametrize(
    ('until_us', 'seq'), [(3_000_000, 42), (1_700_000_000_000_000, 42), (5_072_000, 0)]
)
def test_a_clock_that_jumps_and_a_driver_that_starts_anew_empty_the_history(
    until_us: int, seq: int
) -> None:
    history = EventHistory(60.0)
    add(history, [5_000_100], 5_001_000, 41)
    assert add(history, [until_us - 400], until_us, seq)
    assert history.events().t_us.tolist() == [until_us - 400]
    assert history.restarts == 1


def test_events_by_cell_are_bounded_and_what_is_dropped_is_counted() -> None:
    history = EventHistory(span_s=1.0, most=250)
    for k in range(5 * BATCH):
        add(history, [k], k + 1, k)
    assert len(history.events().t_us) == BATCH
    assert history.dropped == 4 * BATCH
    # Counts go as far back as the events.
    assert history.counts().counts.tolist() == [0]
    add(history, [3_000_000], 3_000_001, 5 * BATCH)
    assert history.events().t_us.tolist() == [3_000_000]
    assert history.dropped == 4 * BATCH


def test_nothing_seen_is_nothing_counted() -> None:
    history = EventHistory(span_s=1.0)
    assert not history.counts().counts.any()
    assert len(history.events().t_us) == 0


@given(x=st.lists(st.integers(0, 345), min_size=1, max_size=50), y=st.integers(0, 259))
def test_events_fall_into_the_cells_of_the_frames(x: list[int], y: int) -> None:
    n = len(x)
    rows = np.full(n, y, np.uint16)
    events = Events(np.arange(n), np.array(x, np.uint16), rows, np.ones(n, np.bool_))
    for column, cell in zip(x, by_cell(events, *SIZE).cell, strict=True):
        assert int(cell) == (65_535 if column >= 340 else y // 10 * 34 + column // 10)
    for size in ((2**32 - 1, 2**32 - 1), (70_000, 10), (0, 0)):
        assert len(by_cell(events, *size).cell) == n


def test_frames_are_bounded_in_time_and_number() -> None:
    history = FrameHistory(1.0)
    assert history.snapshot() is None
    for k in range(300):
        history.push(40_000 * k, 40_000 * k + 100, np.full(4, k, np.float32))
    frames = history.snapshot()
    assert frames is not None
    assert 24 <= len(frames.start_us) <= 26
    assert frames.values[:, 0].tolist() == list(range(300 - len(frames.start_us), 300))
    for k in range(300):
        history.push(12_000_000 + 10 * k, 12_000_005 + 10 * k, np.zeros(4, np.float32))
    frames = history.snapshot()
    assert frames is not None
    assert len(frames.start_us) == FRAMES_PER_S


@pytest.mark.parametrize(
    ('start_us', 'size', 'kept'), [(3000, 5, [3000]), (7, 4, [7]), (3000, 4, [1000, 3000])]
)
def test_frames_of_another_size_or_clock_begin_anew(
    start_us: int, size: int, kept: list[int]
) -> None:
    history = FrameHistory(10.0)
    history.push(1000, 2000, np.zeros(4, np.float32))
    history.push(start_us, start_us + 5, np.zeros(size, np.float32))
    # Neither a picture below a cell nor one without exposure times counts.
    history.push(9000, 9000, np.zeros(size, np.float32))
    history.push(9000, 9100, reduce_frame(np.zeros((260, 9), np.uint8), 255.0))
    frames = history.snapshot()
    assert frames is not None
    assert frames.start_us.tolist() == kept


@given(steps=st.lists(st.integers(-3, 300_000_000), max_size=20), capacity=st.integers(1, 10))
def test_the_latest_increasing_samples_of_the_force_are_kept(
    steps: list[int], capacity: int
) -> None:
    history = ForceHistory(span_s=2.0, capacity=capacity)
    kept: list[int] = []
    now = 1_700_000_000_000_000_000
    for i, step in enumerate(steps):
        now += step
        new = not kept or now // 1000 > kept[-1] // 1000
        assert history.push(now, (float(i), 0.0, now / 1e9)) == new
        if new:
            kept.append(now)
    t, force = history.snapshot('z')
    recent = [k for k in kept[-capacity:] if k >= kept[-1] - SPAN_NS]
    assert np.array_equal(t, np.array(recent, np.int64) / 1e9)
    assert np.array_equal(force, t)
    assert history.refused == len(steps) - len(kept)


def test_a_force_clock_that_is_set_back_starts_over() -> None:
    history = ForceHistory(span_s=10.0, capacity=100)
    history.push(5_000_000_000, (1.0, 2.0, 3.0))
    for t_ns, force in ((5_100_000_000, float('nan')), (0, 1.0), (5_000_000_000, 1.0)):
        assert not history.push(t_ns, (1.0, force, 3.0))
    assert (len(history.snapshot('x')[0]), history.refused, history.restarts) == (1, 3, 0)
    assert history.push(100, (4.0, 5.0, 6.0))
    t, force = history.snapshot('y')
    assert (t.tolist(), force.tolist(), history.restarts) == ([1e-7], [5.0], 1)
