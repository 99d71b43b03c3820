# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Events, time and losses of the virtual camera, read back by a decoder of the test's own."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from usb_oracle import DVS, MUX, USB, camera, decode, drain, events_of, some_frame, write

event_rows = st.lists(
    st.tuples(st.integers(0, 200_000), st.integers(0, 345), st.integers(0, 259), st.booleans()),
    max_size=60,
).map(sorted)


@settings(max_examples=60)
@given(event_rows, st.lists(st.integers(0, 200_000), max_size=6))
def test_events_come_back_exactly_however_time_is_cut(rows, cuts):
    device = camera()
    device.submit(events_of(rows))
    for cut in [*sorted(cuts), 200_001]:
        device.advance(cut)
    decoded = decode(drain(device))
    assert decoded.events == rows
    assert decoded.wraps == [1] * (200_001 // 0x8000)
    # A stamp only when the time changed, never for a time that a wrap has just set.
    assert all(later > earlier for earlier, later in pairwise(decoded.stamps))
    assert not any(t % 0x8000 == 0 for t in decoded.stamps)


def test_events_of_one_row_and_time_share_a_row_word():
    device = camera()
    device.submit(events_of([(5, 7, 1, True), (5, 7, 2, False), (5, 8, 3, True), (6, 8, 4, True)]))
    device.advance(10)
    words = [0x8005, 0x1007, 0x3001, 0x2002, 0x1008, 0x3003, 0x8006, 0x1008, 0x3004]
    assert drain(device).tolist() == words
    assert device.register(DVS, 82) == 3
    assert device.register(DVS, 84) == 4


def test_what_is_known_ahead_of_time_comes_after_a_power_up():
    now_us = [0]
    device = camera(now=now_us)
    device.submit(events_of([(t, 7, 1, True) for t in range(500, 100_000, 1000)]))
    device.advance(30_000)
    device.plug_in()
    device.advance(60_000)
    now_us[0] = 60_000
    write(device, (MUX, 3, 1), (USB, 0, 1), (MUX, 1, 1), (MUX, 0, 1), (USB, 1, 0), (DVS, 3, 1))
    device.advance(100_000)
    expected = [(t, 7, 1, True) for t in range(500, 40_000, 1000)]
    assert decode(drain(device)).events == expected


def test_event_filters():
    rows = [(t, x, y, t % 2 == 0) for t, (x, y) in enumerate([(5, 5), (6, 5), (7, 9), (345, 259)])]
    device = camera()

    def sent(t0, *settings):
        write(device, *settings)
        device.submit(events_of([(t + t0, x, y, p) for t, x, y, p in rows]))
        device.advance(t0 + 100)
        return [(t - t0, x, y, p) for t, x, y, p in decode(drain(device)).events]

    assert sent(100) == rows
    assert sent(300, (DVS, 41, 6), (DVS, 42, 5), (DVS, 43, 7), (DVS, 44, 9)) == rows[1:3]
    assert sent(500, (DVS, 13, 9), (DVS, 14, 7)) == rows[1:2]
    assert device.register(DVS, 88) == 1
    write(device, (DVS, 41, 0), (DVS, 42, 0), (DVS, 43, 345), (DVS, 44, 259), (DVS, 13, 260))
    assert sent(700, (DVS, 62, 1), (DVS, 63, 1)) == [r for r in rows if not r[3]]
    assert sent(900, (DVS, 62, 0), (DVS, 61, 1)) == [(t, x, y, False) for t, x, y, _ in rows]
    assert sent(1100, (DVS, 3, 0)) == []


def test_timestamp_reset_restarts_time_at_zero():
    now = [0]
    device = camera(now=now)
    device.submit(events_of([(10, 1, 2, True), (50_000, 3, 4, True), (50_500, 5, 6, False)]))
    device.advance(49_000)
    now[0] = 50_200
    write(device, (MUX, 2, 1), (MUX, 2, 0))
    device.advance(51_000)
    words = drain(device)
    at = words.tolist().index(1)
    assert decode(words[:at]).events == [(10, 1, 2, True)]
    # What came before the reset was not read out in time and is lost, as with real resets.
    assert decode(words[at:]).events == [(300, 5, 6, False)]


@pytest.mark.parametrize('bit', [(MUX, 0), (MUX, 1), (USB, 0)])
def test_no_data_unless_every_run_bit_is_set(bit):
    device = camera()
    write(device, (*bit, 0))
    device.submit(events_of([(10, 1, 2, True)]))
    device.advance(100_000)
    assert len(drain(device)) == 0
    write(device, (*bit, 1))
    device.submit(events_of([(150_000, 1, 2, True)]))
    device.advance(200_000)
    assert len(decode(drain(device)).events) == 1


@pytest.mark.parametrize(('at_mux', 'register'), [(1, (MUX, 84)), (0, (DVS, 86))])
def test_full_buffer_drops_events_and_counts_them(at_mux, register):
    device = camera(fifo_bytes=4096)
    write(device, (MUX, 5, at_mux))
    sent = 0
    for t in range(0, 200_000, 1000):
        device.submit(events_of([(t + 2 * k, k, 7, True) for k in range(20)]))
        device.advance(t + 1000)
        sent += 20
    decoded = decode(drain(device))
    assert 0 < len(decoded.events) < sent
    assert device.register(*register) == sent - len(decoded.events)
    assert device.losses['events_dropped'] == sent - len(decoded.events)
    # Time goes on all the while.
    assert sum(decoded.wraps) == 200_000 // 0x8000


def test_time_survives_a_buffer_that_is_full_for_seconds():
    device = camera(fifo_bytes=1024)
    device.submit(frames=[some_frame(1000)])
    for t in range(0, 4_000_001, 1000):
        device.advance(t)
    assert device.losses['frames_dropped'] == 1
    first = decode(drain(device))
    device.submit(events_of([(4_500_000, 9, 9, True)]))
    device.advance(4_600_000)
    second = decode(drain(device))
    total = (sum(first.wraps) + sum(second.wraps)) * 0x8000
    assert total == 4_600_000 // 0x8000 * 0x8000
    t, *rest = second.events[0]
    assert (t + sum(first.wraps) * 0x8000, *rest) == (4_500_000, 9, 9, True)
