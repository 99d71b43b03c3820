# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Encodings: round trips, an independent decoder, and what is refused."""

from __future__ import annotations

import functools
import struct
from array import array
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixtac_core.events import codec
from mixtac_core.events.arrays import Events
from mixtac_core.events.codec import MAX_SPAN_US, MAX_TIME_BASE, decode_message, encode, warm_up
from mixtac_core.events.packets import CodecError, EncodedPacket

EPOCH_US = 1_700_000_000_000_000


def make(rows: list[tuple[int, int, int, bool]]) -> Events:
    columns = zip(*rows, strict=True) if rows else ((), (), (), ())
    kinds = (np.int64, np.uint16, np.uint16, np.bool_)
    return Events(*map(np.array, columns, kinds))


def rows_of(events: Events) -> list[tuple[int, int, int, bool]]:
    return list(zip(*(column.tolist() for column in events.fields), strict=True))


decode = functools.partial(codec.decode, width=346, height=260)


def closed(events: Events) -> EncodedPacket:
    """Encode a packet that ends with its last event."""
    return encode(events, complete_until=int(events.t[-1]))


def plain_decode(payload: bytes, time_base_ns: int) -> tuple[list[tuple[int, int, int, bool]], int]:
    """Decode word by word, straight from the byte layout; events and the final time."""
    events = []
    high = low = 0
    column = base = on = None
    for (word,) in struct.iter_unpack('<H', payload):
        code, value = word // 4096, word % 4096
        now = time_base_ns // 1000 + high * 4096 + low
        if code == 0:
            high = value
        elif code == 1:
            low = value
        elif code == 2:
            column = value
        elif code == 3:
            events.append((now, column, value % 2048, value >= 2048))
        elif code == 4:
            base, on = value % 2048, value >= 2048
        elif code == 5:
            events += [(now, column, base + i, on) for i in range(8) if value & (1 << i)]
            base += 8
        else:
            raise AssertionError(word)
    return events, time_base_ns // 1000 + high * 4096 + low


STARTS = st.sampled_from([0, 1, 4095, EPOCH_US, EPOCH_US + 123_456]) | st.integers(0, 2 * 10**15)


@st.composite
def streams(draw: st.DrawFn) -> Events:
    """Draw streams of bursts in one column, single events, repeats and long gaps."""
    rows = []
    now = draw(STARTS | st.integers(2**31 - 2000, 2**31 + 2))
    gaps = st.sampled_from([0, 0, 1, 5, 4095, 4096, 70_000])
    bursts = st.tuples(
        gaps,
        st.integers(0, 345),
        st.lists(st.integers(0, 259) | st.integers(8, 40), max_size=30),
        st.booleans(),
        st.booleans(),
    )
    for gap, column, lines, on, tidy in draw(st.lists(bursts, max_size=12)):
        now += gap
        rows += [(now, column, y, on) for y in (sorted(lines) if tidy else lines)]
    return make(rows)


@given(events=streams(), wait=st.integers(0, 100_000))
def test_round_trip_and_independent_decoder(events: Events, wait: int) -> None:
    end = int(events.t[-1]) + wait if len(events) else EPOCH_US + wait
    packet = encode(events, complete_until=end)
    back = decode(packet.payload, packet.encoding, packet.time_base)
    assert rows_of(back.events) == rows_of(events)
    assert back.start_us == (int(events.t[0]) if len(events) else end)
    assert back.complete_until == end
    assert packet.time_base == 1000 * back.start_us
    dtypes = [each.dtype for each in (back.events.t, back.events.x, back.events.y)]
    assert dtypes == [np.int64, np.uint16, np.uint16]
    plain = plain_decode(packet.payload.tobytes(), packet.time_base)
    assert plain == (rows_of(events), end)


def fewest_row_words(rows: list[int]) -> int:
    """Return the length of the shortest code of ascending rows, by trying all codes."""
    best = [0] + [10**6] * len(rows)
    for i in range(len(rows)):
        best[i + 1] = min(best[i + 1], best[i] + 1)
        for j in range(i, len(rows)):
            words = 2 + rows[j] // 8 - rows[i] // 8
            best[j + 1] = min(best[j + 1], best[i] + words)
    return best[-1]


@given(rows=st.sets(st.integers(0, 259) | st.integers(0, 40), min_size=1, max_size=60))
def test_vectors_make_the_shortest_code(rows: set[int]) -> None:
    ordered = sorted(rows)
    packet = closed(make([(7, 3, y, True) for y in ordered]))
    assert packet.payload.size == 2 * (1 + fewest_row_words(ordered))


def test_coordinates_up_to_the_bits_of_the_encoding() -> None:
    corners = make([(0, 2047, 0, False), (0, 0, 2047, True), (0, 2047, 2047, True)])
    packet = closed(corners)
    back = decode(packet.payload, packet.encoding, packet.time_base, width=2048, height=2048)
    assert rows_of(back.events) == rows_of(corners)
    for x, y in ((2048, 0), (0, 2048)):
        with pytest.raises(CodecError):
            closed(make([(0, x, y, True)]))


@pytest.mark.parametrize('rows', [[(346, 0)], [(0, 260)], [(1, y) for y in range(256, 264)]])
def test_events_outside_the_sensor_are_refused(rows: list[tuple[int, int]]) -> None:
    packet = closed(make([(0, x, y, True) for x, y in rows]))
    with pytest.raises(CodecError):
        decode(packet.payload, packet.encoding, packet.time_base)
    whole = decode(packet.payload, packet.encoding, 0, width=347, height=264)
    assert len(whole.events) == len(rows)


def test_packets_that_span_too_long_are_refused() -> None:
    longest = 2**24 - 1
    events = make([(0, 0, 0, True), (longest, 1, 1, True)])
    assert decode(closed(events).payload, 'libcaer_cmp', 0).complete_until == longest
    with pytest.raises(CodecError):
        closed(make([(0, 0, 0, True), (longest + 1, 1, 1, True)]))
    with pytest.raises(CodecError):
        closed(events[::-1])
    with pytest.raises(CodecError):
        encode(events, complete_until=longest + 1)


@pytest.mark.parametrize(
    ('encoding', 'payload'),
    [
        ('jpeg', b''),
        ('libcaer_cmp', b'\x00\x20\x00'),
        ('libcaer_cmp', struct.pack('<H', 0x3000)),
        ('libcaer_cmp', struct.pack('<HH', 0x4000, 0x5001)),
        ('libcaer_cmp', struct.pack('<HH', 0x2000, 0x5001)),
        ('libcaer_cmp', struct.pack('<HHH', 0x2000, 0x4000, 0x6001)),
        ('libcaer_cmp', struct.pack('<H', 0xF000)),
    ],
)
def test_damaged_payloads_are_refused(encoding: str, payload: bytes) -> None:
    with pytest.raises(CodecError):
        decode(payload, encoding, 0)


@settings(max_examples=300)
@given(payload=st.binary(max_size=60))
def test_arbitrary_bytes_decode_or_are_refused(payload: bytes) -> None:
    try:
        packet = decode(payload, 'libcaer_cmp', EPOCH_US * 1000)
    except CodecError:
        return
    assert (rows_of(packet.events), packet.complete_until) == plain_decode(payload, EPOCH_US * 1000)


def message(encoding: str, payload: bytes, **fields: object) -> SimpleNamespace:
    """Return a message, by default one of the first microsecond of this sensor."""
    values = {'seq': 0, 'width': 346, 'height': 260, 'time_base': 0, 'is_bigendian': False}
    return SimpleNamespace(encoding=encoding, events=array('B', payload), **{**values, **fields})


@settings(max_examples=300)
@given(
    payload=st.binary(max_size=60),
    encoding=st.sampled_from(['libcaer_cmp', 'libcaer', '', 'evt2']),
    time_base=st.integers(0, 2**64 - 1) | st.sampled_from([10**18, 2**63, 2**64 - 1]),
    width=st.integers(0, 2**32 - 1),
    height=st.integers(0, 2**32 - 1),
    is_bigendian=st.booleans(),
)
def test_any_message_decodes_or_is_refused(payload, encoding, **fields):
    try:
        packet = decode_message(message(encoding, payload, **fields))
    except CodecError:
        return
    assert packet.complete_until - packet.start_us <= MAX_SPAN_US
    assert 1000 * packet.complete_until < MAX_TIME_BASE


@pytest.mark.parametrize('time_base', [-1, MAX_TIME_BASE, 2**63, 2**64 - 1])
def test_times_beyond_a_stamp_are_refused(time_base: int) -> None:
    payload = closed(make([(5, 1, 1, True)])).payload
    for octets in (payload, b''):
        with pytest.raises(CodecError):
            decode(octets, 'libcaer_cmp', time_base)
    assert decode(payload, 'libcaer_cmp', 10**18).events.t[0] >= 10**15


def test_payload_types_and_messages() -> None:
    warm_up()
    events = make([(EPOCH_US, 3, y, y % 2 == 0) for y in range(9)])
    packet = closed(events[np.arange(9)])
    raw = packet.payload.tobytes()
    for payload in (raw, bytearray(raw), memoryview(raw), array('B', raw), packet.payload):
        assert rows_of(decode(payload, packet.encoding, packet.time_base).events) == rows_of(events)
    time_base = np.uint64(packet.time_base + 999)
    found = decode_message(message(packet.encoding, raw, time_base=time_base))
    assert rows_of(found.events) == rows_of(events)


def test_strided_and_reversed_views_are_encoded() -> None:
    events = make([(t, t, t, True) for t in range(10)])
    packet = closed(events[::3])
    assert rows_of(decode(packet.payload, packet.encoding, 0).events) == rows_of(events)[::3]
