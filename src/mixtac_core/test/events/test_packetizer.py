# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Packets cut on the grid: nothing lost, nothing late, time always progresses."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixtac_core.events import codec
from mixtac_core.events.arrays import Events
from mixtac_core.events.packetizer import Packetizer

decode = functools.partial(codec.decode, width=346, height=260)

BASE = 1_760_000_000_000_000


def events(times):
    t = np.array(times, np.int64) + BASE
    n = len(t)
    rng = np.random.default_rng(n)
    x, y = rng.integers(0, 346, n), rng.integers(0, 260, n)
    return Events(t, x.astype(np.uint16), y.astype(np.uint16), rng.random(n) < 0.5)


@st.composite
def batches(draw):
    """Stretches of a stream: times of events, time reached."""
    time, out = 0, []
    for _ in range(draw(st.integers(1, 12))):
        times = []
        for step in draw(st.lists(st.sampled_from([0, 0, 1, 7, 300, 1500]), max_size=20)):
            time += step
            times.append(time)
        time += draw(st.sampled_from([0, 1, 500, 999, 1000, 33_000, 20_000_000]))
        out.append((events(times), time + BASE))
    return out


@settings(max_examples=200)
@given(
    batches(),
    st.sampled_from([100, 1000, 2500]),
    st.sampled_from([8, 40, 300_000]),
)
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
        assert not sent or complete >= time // period * period or time < BASE + period
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
    part = events([10, 20])
    packetizer = Packetizer(1000, 1000)
    assert packetizer.push(part, BASE + 20, 0) == []
    part.t[:] = 0
    (packet,) = packetizer.push(Events.empty(), BASE + 1000, 1)
    encoded = packet.encode()
    assert decode(encoded.payload, encoded.encoding, encoded.time_base).events.t[0] == BASE + 10
    assert packet.arrival_ns == 0


def test_silence_comes_as_empty_packets():
    packetizer = Packetizer(1000, 1000)
    times = [BASE + 32768 * k for k in range(4)]
    packets = [packetizer.push(Events.empty(), t, k) for k, t in enumerate(times)]
    assert [len(p) for p in packets] == [0, 1, 1, 1]
    for pushed, t in zip(packets[1:], times[1:], strict=True):
        assert pushed[0].encode().time_base == t // 1000 * 1_000_000


@pytest.mark.parametrize('count', [1, 99, 1000])
def test_floods_within_a_cell_are_cut_by_size(count):
    packetizer = Packetizer(1000, 80)
    packets = packetizer.push(events([5] * count), BASE + 6, 0)
    assert [len(p.events) for p in packets] == [10] * (count // 10)
