# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What is remembered of events, frames and force, in bounded memory."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixtac_core.events.arrays import Events
from mixtac_core.events.packets import DecodedPacket
from mixtac_fger.alignment.clock_fit import GapError
from mixtac_fger.alignment.histories import (
    BATCH,
    WAITING,
    EventHistory,
    FrameHistory,
    by_cell,
    force_arrays,
)

SIZE = (346, 260)
EPOCH_US = 1_700_000_000_000_000


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
    counts, _ = history.snapshot()
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
    counts, found = history.snapshot()
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
    assert history.snapshot()[1].t_us.tolist() == [until_us - 400]


def test_the_latest_events_are_kept_and_counted() -> None:
    history = EventHistory(span_s=1.0, most=250)
    counts, events = history.snapshot()
    assert not counts.counts.any()
    assert len(events.t_us) == 0
    for k in range(5 * BATCH):
        add(history, [k], k + 1, k)
    counts, events = history.snapshot()
    assert len(events.t_us) == BATCH
    # Counts go as far back as the events.
    assert counts.counts.tolist() == [0]
    add(history, [3_000_000], 3_000_001, 5 * BATCH)
    assert history.snapshot()[1].t_us.tolist() == [3_000_000]


@given(x=st.lists(st.integers(0, 345), min_size=1, max_size=50), y=st.integers(0, 259))
def test_events_fall_into_the_cells_of_the_frames(x: list[int], y: int) -> None:
    n = len(x)
    rows = np.full(n, y, np.uint16)
    events = Events(np.arange(n), np.array(x, np.uint16), rows, np.ones(n, np.bool_))
    for column, cell in zip(x, by_cell(events, *SIZE).cell, strict=True):
        assert int(cell) == (65_535 if column >= 340 else y // 10 * 34 + column // 10)
    for size in ((2**32 - 1, 2**32 - 1), (70_000, 10), (0, 0)):
        assert len(by_cell(events, *size).cell) == n


def image(stamp_us: int, size: int = 20) -> SimpleNamespace:
    header = SimpleNamespace(stamp=stamp(stamp_us))
    data = bytes([stamp_us % 251]) * size**2
    return SimpleNamespace(
        header=header, height=size, width=size, step=size, encoding='mono8', data=data
    )


def exposure(stamp_us: int, length_us: int = 100) -> SimpleNamespace:
    times = {'exposure_start': stamp(stamp_us), 'exposure_end': stamp(stamp_us + length_us)}
    return SimpleNamespace(header=SimpleNamespace(stamp=stamp(stamp_us)), **times)


def stamp(t_us: int) -> SimpleNamespace:
    return SimpleNamespace(sec=t_us // 1_000_000, nanosec=t_us % 1_000_000 * 1000)


def test_images_are_joined_with_their_exposures_and_bounded_in_time() -> None:
    history = FrameHistory(1.0)
    assert history.snapshot() is None
    for k in range(100):
        history.add_image(image(40_000 * k))
        if k % 2:
            history.add_exposure(exposure(40_000 * k))
    frames = history.snapshot()
    assert frames is not None
    assert np.diff(frames.start_us).tolist() == [80_000] * (len(frames.start_us) - 1)
    assert (frames.end_us == frames.start_us + 100).all()
    assert frames.start_us[-1] - 1_000_000 <= frames.start_us[0] <= frames.start_us[-1] - 920_000
    # An image that waited too long has no partner any more.
    late = 40_000 * (98 - 2 * WAITING)
    history.add_exposure(exposure(late))
    frames = history.snapshot()
    assert frames is not None
    assert late not in frames.start_us


def test_frames_of_another_size_without_cells_or_without_times_are_left_out() -> None:
    history = FrameHistory(10.0)
    for stamp_us, size, length_us in ((1, 20, 9), (2, 30, 9), (3, 30, 0), (4, 9, 9), (5, 30, 9)):
        history.add_exposure(exposure(stamp_us, length_us))
        history.add_image(image(stamp_us, size))
    frames = history.snapshot()
    assert frames is not None
    assert frames.start_us.tolist() == [2, 5]


def test_force_samples_are_sorted_and_those_without_stamp_or_number_left_out() -> None:
    samples = [(2_000_000, 2.0), (0, 9.0), (3_000_000, np.nan), (1_000_000, 1.0), (2_000_000, 7.0)]
    t_s, force = force_arrays(samples)
    assert t_s.tolist() == [0.001, 0.002]
    assert force.tolist() == [1.0, 2.0]
    assert [len(each) for each in force_arrays([])] == [0, 0]
    with pytest.raises(GapError):
        force_arrays([(5_000_000_000, 1.0), (3_000_000_000, 1.0)])
