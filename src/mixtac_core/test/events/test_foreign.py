# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Encodings of other drivers: words written here one by one come out as events."""

from __future__ import annotations

import struct
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixtac_core.events.codec import StreamDecoder, decode
from mixtac_core.events.packets import CodecError

SIZE = {'width': 640, 'height': 480}
ROW = 0
EVENT = 2
BASE = 3
VECTOR_12 = 4
VECTOR_8 = 5
TIME_LOW = 6
TIME_HIGH = 8
TRIGGER = 10
OTHERS = 14
CONTINUED = 15


def words(*pairs: tuple[int, int]) -> np.ndarray:
    return np.array([kind << 12 | value for kind, value in pairs], '<u2').view(np.uint8)


def message(payload, encoding='evt3', **fields):
    values = {'seq': 0, 'time_base': 0, 'is_bigendian': False, **SIZE}
    return SimpleNamespace(**{**values, **fields}, encoding=encoding, events=payload)


def rows(packet) -> list[tuple[int, int, int, bool]]:
    return list(zip(*(column.tolist() for column in packet.events.fields), strict=True))


def test_times_mean_nothing_before_their_upper_bits():
    decoder = StreamDecoder()
    known = []
    for payload in (words((TIME_LOW, 7), (EVENT, 5)), words((TIME_HIGH, 2)), words((TIME_LOW, 9))):
        decoder.decode(message(payload))
        known.append(decoder.timed)
    assert known == [False, True, True]


def test_single_events_and_vectors():
    payload = words(
        (EVENT, 5),
        (TIME_HIGH, 2),
        (EVENT, 6),
        (TIME_LOW, 7),
        (ROW, 30),
        (EVENT, 0x800 | 100),
        (TRIGGER, 1),
        (OTHERS, 0x19),
        (CONTINUED, 3),
        (BASE, 0x800 | 200),
        (VECTOR_12, 0b1000_0000_0001),
        (VECTOR_8, 0b0000_0010),
        (TIME_LOW, 9),
        (BASE, 300),
        (VECTOR_8, 1),
        (TIME_LOW, 12),
    )
    found = StreamDecoder().decode(message(payload))
    assert rows(found) == [
        (0x2007, 100, 30, True),
        (0x2007, 200, 30, True),
        (0x2007, 211, 30, True),
        (0x2007, 213, 30, True),
        (0x2009, 300, 30, False),
    ]
    assert found.complete_until == 0x200C


@given(st.lists(st.integers(1, 15_000_000), min_size=1, max_size=20), st.integers(0, 3))
def test_times_roll_over_and_packets_may_be_cut_anywhere(steps, early):
    times = np.cumsum(steps).tolist()
    pairs = [(OTHERS, 0)] * early
    for t in times:
        pairs += [(TIME_HIGH, t >> 12 & 0xFFF), (TIME_LOW, t & 0xFFF), (ROW, 3), (EVENT, 4)]
    decoder = StreamDecoder()
    found = [
        row[0]
        for at in range(0, len(pairs), 4)
        for row in rows(decoder.decode(message(words(*pairs[at : at + 4]))))
    ]
    assert found == times


def test_a_packet_cut_within_a_time_announces_no_more_than_it_knows():
    decoder = StreamDecoder()
    first = words((TIME_HIGH, 1), (TIME_LOW, 4000), (EVENT, 1), (TIME_HIGH, 2))
    assert decoder.decode(message(first)).complete_until == 2 << 12
    found = decoder.decode(message(words((TIME_LOW, 5), (EVENT, 2))))
    assert rows(found) == [(2 << 12 | 5, 2, 0, False)]


def test_a_time_that_goes_back_a_little_is_no_roll_over():
    payload = words(
        (TIME_HIGH, 20), (TIME_LOW, 0), (EVENT, 1), (TIME_HIGH, 19), (TIME_LOW, 5), (EVENT, 2)
    )
    found = StreamDecoder().decode(message(payload))
    assert rows(found) == [(19 << 12 | 5, 2, 0, False), (20 << 12, 1, 0, False)]
    assert found.complete_until == 20 << 12


def test_a_cut_off_word_is_refused():
    with pytest.raises(CodecError):
        StreamDecoder().decode(message(np.zeros(3, np.uint8)))


def libcaer(*events: tuple[int, int, int, bool]) -> bytes:
    """Encode events by the layout of `libcaer`; all are valid."""
    words = [(x << 17 | y << 2 | on << 1 | 1, t % 2**31) for t, x, y, on in events]
    return b''.join(struct.pack('<Ii', *word) for word in words)


@given(
    start=st.sampled_from([0, 2**31 - 1000, 1_700_000_000_000_000]) | st.integers(0, 2 * 10**15),
    steps=st.lists(st.sampled_from([0, 1, 1000, 2**24 - 1, 2**30 - 1]), max_size=12),
)
def test_libcaer_crosses_roll_overs(start, steps):
    times = np.cumsum([start, *steps]).tolist()
    sent = [(t, 40 * i, 30 * i, bool(i % 2)) for i, t in enumerate(times)]
    base_ns = (start >> 31 << 31) * 1000
    found = decode(libcaer(*sent), 'libcaer', base_ns, **SIZE)
    assert rows(found) == sent
    assert found.complete_until == times[-1]


def test_events_marked_as_not_valid_are_left_out():
    payload = struct.pack('<IiIi', 0b11, 5, 0b10, 9)
    packet = decode(payload, 'libcaer', 0, **SIZE)
    assert rows(packet) == [(5, 0, 0, True)]
    assert packet.complete_until == 9


@pytest.mark.parametrize(
    'payload',
    [libcaer((0, 640, 0, True)), libcaer((0, 0, 480, True)), bytes(7), struct.pack('<Ii', 1, -1)],
)
def test_damaged_libcaer_is_refused(payload):
    with pytest.raises(CodecError):
        decode(payload, 'libcaer', 0, **SIZE)
