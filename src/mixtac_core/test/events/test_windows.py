# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Packets and windows partition the stream, whichever way it arrives."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixtac_core.events import codec
from mixtac_core.events.arrays import Events
from mixtac_core.events.windows import Packetizer, WindowSlicer

EPOCH_US = 1_700_000_000_000_000


def at(times: list[int]) -> Events:
    n = len(times)
    x = np.arange(n) % 346
    t, y = np.array(times, np.int64), np.zeros(n, np.uint16)
    return Events(t, x.astype(np.uint16), y, np.arange(n) % 3 == 0)


decode = functools.partial(codec.decode, width=346, height=260)


@st.composite
def batches(draw):
    """Stretches of a stream: times of events, time reached."""
    time, out = 0, []
    for _ in range(draw(st.integers(1, 12))):
        times = []
        for step in draw(st.lists(st.sampled_from([0, 0, 1, 7, 300, 1500]), max_size=20)):
            time += step
            times.append(EPOCH_US + time)
        time += draw(st.sampled_from([0, 1, 500, 999, 1000, 33_000, 20_000_000]))
        out.append((at(times), time + EPOCH_US))
    return out


@settings(max_examples=200)
@given(batches(), st.sampled_from([100, 1000, 2500]), st.sampled_from([8, 40, 300_000]))
def test_packets_hold_every_event_once_and_say_how_far_they_reach(parts, period, size):
    packetizer = Packetizer(period, size)
    sent, complete = [], 0
    for k, (part, time) in enumerate(parts):
        for packet in packetizer.push(part, time, arrival_ns=k):
            encoded = packet.encode()
            got = decode(encoded.payload, encoded.encoding, encoded.time_base)
            found = got.events
            assert len(encoded.payload) <= max(size, 8) + 8
            assert len(found) == len(packet.events)
            if len(found):
                assert found.t[0] >= complete
                assert found.t[-1] // period == found.t[0] // period
            assert complete <= got.complete_until <= time
            assert packet.complete_until_us == got.complete_until
            assert packet.arrival_ns <= k
            complete = got.complete_until
            sent.append(found)
        assert not sent or complete >= time // period * period or time < EPOCH_US + period
    whole = Events.concatenate([part for part, _ in parts])
    out = Events.concatenate(sent)
    n = len(out)
    np.testing.assert_array_equal(out.t, whole.t[:n])
    order = [np.lexsort((e.polarity, e.y, e.x, e.t)) for e in (out, whole[:n])]
    for name in ('x', 'y', 'polarity'):
        np.testing.assert_array_equal(
            getattr(out, name)[order[0]], getattr(whole, name)[:n][order[1]]
        )
    still_open = whole.t[n:]
    assert (still_open // period == parts[-1][1] // period).all()


def test_events_may_be_overwritten_after_the_call():
    part = at([EPOCH_US + 10, EPOCH_US + 20])
    packetizer = Packetizer(1000, 1000)
    assert packetizer.push(part, EPOCH_US + 20, 0) == []
    part.t[:] = 0
    (packet,) = packetizer.push(Events.empty(), EPOCH_US + 1000, 1)
    encoded = packet.encode()
    assert decode(encoded.payload, encoded.encoding, encoded.time_base).events.t[0] == EPOCH_US + 10
    assert packet.arrival_ns == 0


def test_silence_comes_as_empty_packets():
    packetizer = Packetizer(1000, 1000)
    times = [EPOCH_US + 32768 * k for k in range(4)]
    packets = [packetizer.push(Events.empty(), t, k) for k, t in enumerate(times)]
    assert [len(p) for p in packets] == [0, 1, 1, 1]
    for pushed, t in zip(packets[1:], times[1:], strict=True):
        assert pushed[0].encode().time_base == t // 1000 * 1_000_000


@pytest.mark.parametrize('count', [1, 99, 1000])
def test_floods_within_a_cell_are_cut_by_size(count):
    packetizer = Packetizer(1000, 80)
    packets = packetizer.push(at([EPOCH_US + 5] * count), EPOCH_US + 6, 0)
    assert [len(p.events) for p in packets] == [10] * (count // 10)


GAPS = st.lists(st.sampled_from([0, 1, 3, 700, 2000, 9000]) | st.integers(0, 400), min_size=1)


@given(
    gaps=GAPS,
    start=st.sampled_from([-5000, 0, EPOCH_US]),
    width=st.integers(1, 3000),
    cuts=st.lists(st.integers(0, 100), max_size=5),
    max_run=st.integers(1, 40),
)
def test_windows_partition_the_events(
    gaps: list[int], start: int, width: int, cuts: list[int], max_run: int
) -> None:
    times = (start + np.cumsum(gaps)).tolist()
    events = at(times)
    slicer = WindowSlicer(width, max_empty_run=max_run)
    borders = sorted(min(c, len(times)) for c in cuts)
    windows = []
    until = times[0]
    for a, b in zip([0, *borders], [*borders, len(times)], strict=True):
        until = times[b - 1] if b > a else until
        windows += slicer.push(events[a:b], until)
    windows += slicer.push(Events.empty(), times[-1] + width)
    ends = np.array([end for end, _ in windows])
    assert np.all(ends % width == 0)
    steps = np.diff(ends) // width
    assert np.all(steps >= 1)
    assert slicer.late_events == 0
    for end, content in windows:
        assert np.all((content.t >= end - width) & (content.t < end))
    assert np.concatenate([c.t for _, c in windows]).tolist() == times
    assert np.concatenate([c.x for _, c in windows]).tolist() == list(range(len(times)))


def test_a_window_closes_as_soon_as_it_is_complete() -> None:
    slicer = WindowSlicer(1000)
    assert slicer.push(at([100]), 999) == []
    assert slicer.push(at([999]), 999) == []
    [(end, content)] = slicer.push(Events.empty(), 1000)
    assert (end, content.t.tolist()) == (1000, [100, 999])


def test_long_gaps_give_the_latest_empty_windows() -> None:
    slicer = WindowSlicer(1000, max_empty_run=3)
    windows = slicer.push(at([500, 20_500]), 30_000)
    assert [end for end, _ in windows] == [1000, 21_000, 28_000, 29_000, 30_000]


def test_late_events_are_dropped_and_counted() -> None:
    slicer = WindowSlicer(1000)
    slicer.push(at([100]), 5000)
    [(_, content)] = slicer.push(at([4999, 5000, 5001]), 6000)
    assert content.t.tolist() == [5000, 5001]
    assert slicer.late_events == 1


def test_events_out_of_order_are_sorted_into_their_windows() -> None:
    slicer = WindowSlicer(1000)
    slicer.push(at([0, 1500]), 0)
    windows = slicer.push(at([700, 1200]), 2000)
    assert [c.t.tolist() for _, c in windows] == [[0, 700], [1200, 1500]]


def test_a_restarted_clock_starts_over() -> None:
    slicer = WindowSlicer(1000)
    slicer.push(at([10_000_000]), 10_000_500)
    windows = slicer.push(at([200]), 1000)
    assert [(end, c.t.tolist()) for end, c in windows] == [(1000, [200])]
    assert slicer.late_events == 0
