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
from mixtac_core.events.codec import (
    ENCODINGS,
    MAX_SPAN_US,
    MAX_TIME_BASE,
    decode_message,
    encode,
    warm_up,
)
from mixtac_core.events.errors import MixtacError
from mixtac_core.events.packets import CodecError

EPOCH_US = 1_700_000_000_000_000


def make(rows: list[tuple[int, int, int, bool]]) -> Events:
    t, x, y, on = zip(*rows, strict=True) if rows else ((), (), (), ())
    return Events(
        np.array(t, np.int64),
        np.array(x, np.uint16),
        np.array(y, np.uint16),
        np.array(on, np.bool_),
    )


def rows_of(events: Events) -> list[tuple[int, int, int, bool]]:
    return list(
        zip(
            events.t.tolist(),
            events.x.tolist(),
            events.y.tolist(),
            events.polarity.tolist(),
            strict=True,
        )
    )


decode = functools.partial(codec.decode, width=346, height=260)


def plain_decode(
    payload: bytes, encoding: str, time_base_ns: int
) -> tuple[list[tuple[int, int, int, bool]], int]:
    """Decode word by word, straight from the byte layout; events and the final time."""
    if encoding == 'libcaer':
        return plain_decode_libcaer(payload, time_base_ns)
    events = []
    high = low = 0
    column = base = on = None
    for (word,) in struct.iter_unpack('<H', payload):
        code, value = word // 4096, word % 4096
        if code == 0:
            high = value
        elif code == 1:
            low = value
        elif code == 2:
            column = value
        elif code == 3:
            now = time_base_ns // 1000 + high * 4096 + low
            events.append((now, column, value % 2048, value >= 2048))
        elif code == 4:
            base, on = value % 2048, value >= 2048
        elif code == 5:
            now = time_base_ns // 1000 + high * 4096 + low
            events += [(now, column, base + i, on) for i in range(8) if value & (1 << i)]
            base += 8
        else:
            raise AssertionError(word)
    return events, time_base_ns // 1000 + high * 4096 + low


def plain_decode_libcaer(
    payload: bytes, time_base_ns: int
) -> tuple[list[tuple[int, int, int, bool]], int]:
    events = []
    rolled = before = now = 0
    for data, stamp in struct.iter_unpack('<Ii', payload):
        rolled += 2**31 if stamp < before else 0
        before = stamp
        now = time_base_ns // 1000 + stamp + rolled
        if data % 2:
            events.append((now, data >> 17, (data >> 2) % 2**15, bool(data & 2)))
    return events, now


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


@pytest.mark.parametrize('encoding', ENCODINGS)
@given(events=streams(), wait=st.integers(0, 100_000))
def test_round_trip_and_independent_decoder(encoding: str, events: Events, wait: int) -> None:
    end = int(events.t[-1]) + wait if len(events) else EPOCH_US + wait
    packet = encode(events, encoding, complete_until=end)
    back = decode(packet.payload, encoding, packet.time_base)
    assert rows_of(back.events) == rows_of(events)
    assert back.start_us == (int(events.t[0]) if len(events) else end)
    assert [a.dtype for a in (back.events.t, back.events.x, back.events.y)] == [
        np.int64,
        np.uint16,
        np.uint16,
    ]
    plain, last = plain_decode(packet.payload.tobytes(), encoding, packet.time_base)
    assert plain == rows_of(events)
    if len(events) == 0:
        assert packet.payload.size == 0
        assert back.complete_until == end == packet.time_base // 1000
    elif encoding == 'libcaer_cmp':
        assert back.complete_until == end == last
        assert packet.time_base == int(events.t[0]) * 1000
    else:
        assert back.complete_until == int(events.t[-1]) == last
        assert packet.time_base % (2**31 * 1000) == 0


@pytest.mark.parametrize('encoding', ENCODINGS)
@given(events=streams(), cuts=st.lists(st.integers(0, 300), max_size=6))
def test_any_split_into_packets_gives_the_same_stream(
    encoding: str, events: Events, cuts: list[int]
) -> None:
    borders = sorted(min(c, len(events)) for c in cuts)
    parts = [events[a:b] for a, b in zip([0, *borders], [*borders, len(events)], strict=True)]
    back = []
    until = 0
    for part in parts:
        until = int(part.t[-1]) if len(part) else until
        packet = encode(part, encoding, complete_until=until)
        back.append(decode(packet.payload, encoding, packet.time_base).events)
    assert rows_of(Events.concatenate(back)) == rows_of(events)


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
    packet = encode(make([(7, 3, y, True) for y in ordered]))
    assert packet.payload.size == 2 * (1 + fewest_row_words(ordered))


@given(
    start=STARTS,
    steps=st.lists(st.sampled_from([0, 1, 1000, 2**24 - 1, 2**30 - 1]), min_size=1, max_size=12),
)
def test_libcaer_crosses_roll_overs(start: int, steps: list[int]) -> None:
    times = np.cumsum([start, *steps]).tolist()
    events = make([(t, i, i, bool(i % 2)) for i, t in enumerate(times)])
    packet = encode(events, 'libcaer')
    assert rows_of(decode(packet.payload, 'libcaer', packet.time_base).events) == rows_of(events)
    assert plain_decode(packet.payload.tobytes(), 'libcaer', packet.time_base)[0] == rows_of(events)


@pytest.mark.parametrize(('encoding', 'largest'), [('libcaer_cmp', 2047), ('libcaer', 32767)])
def test_coordinates_up_to_the_bits_of_the_encoding(encoding: str, largest: int) -> None:
    corners = make([(0, largest, 0, False), (0, 0, largest, True), (0, largest, largest, True)])
    packet = encode(corners, encoding)
    side = largest + 1
    back = decode(packet.payload, encoding, packet.time_base, width=side, height=side)
    assert rows_of(back.events) == rows_of(corners)
    for x, y in ((side, 0), (0, side)):
        with pytest.raises(CodecError):
            encode(make([(0, x, y, True)]), encoding)


@pytest.mark.parametrize('encoding', ENCODINGS)
@pytest.mark.parametrize(('x', 'y'), [(346, 0), (0, 260)])
def test_events_outside_the_sensor_are_refused(encoding: str, x: int, y: int) -> None:
    packet = encode(make([(0, x, y, True)]), encoding)
    with pytest.raises(CodecError):
        decode(packet.payload, encoding, packet.time_base)
    assert len(decode(packet.payload, encoding, 0, width=347, height=261).events) == 1


def test_vectors_outside_the_sensor_are_refused() -> None:
    packet = encode(make([(0, 1, y, True) for y in range(256, 264)]))
    assert packet.payload.size == 6
    with pytest.raises(CodecError):
        decode(packet.payload, 'libcaer_cmp', 0)


@pytest.mark.parametrize('encoding', ENCODINGS)
def test_times_that_decrease_are_refused(encoding: str) -> None:
    with pytest.raises(CodecError):
        encode(make([(5, 0, 0, True), (4, 0, 0, True)]), encoding)


def test_packets_that_span_too_long_are_refused() -> None:
    longest = 2**24 - 1
    events = make([(0, 0, 0, True), (longest, 1, 1, True)])
    assert decode(encode(events).payload, 'libcaer_cmp', 0).complete_until == longest
    for late in (
        lambda: encode(make([(0, 0, 0, True), (longest + 1, 1, 1, True)])),
        lambda: encode(events, complete_until=longest + 1),
        lambda: encode(make([(0, 0, 0, True), (2**30, 1, 1, True)]), 'libcaer'),
    ):
        with pytest.raises(CodecError):
            late()


def test_other_events_that_no_packet_can_carry() -> None:
    with pytest.raises(CodecError):
        encode(make([(-1, 0, 0, True)]))
    with pytest.raises(CodecError):
        encode(make([(5, 0, 0, True)]), complete_until=4)
    with pytest.raises(CodecError):
        encode(Events.empty())
    with pytest.raises(MixtacError):
        encode(Events.empty(), 'evt2', complete_until=0)
    with pytest.raises(MixtacError):
        decode(b'', 'jpeg', 0)


@pytest.mark.parametrize(
    ('encoding', 'payload'),
    [
        ('libcaer_cmp', b'\x00\x20\x00'),
        ('libcaer', b'\x01\x00\x00\x00\x00\x00\x00'),
        ('libcaer', struct.pack('<Ii', 1, -1)),
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
@given(payload=st.binary(max_size=60), encoding=st.sampled_from(ENCODINGS))
def test_arbitrary_bytes_decode_or_are_refused(payload: bytes, encoding: str) -> None:
    try:
        packet = decode(payload, encoding, EPOCH_US * 1000)
    except CodecError:
        return
    if encoding == 'libcaer_cmp':
        plain, last = plain_decode(payload, encoding, EPOCH_US * 1000)
        assert rows_of(packet.events) == plain
        assert packet.complete_until == (last if payload else EPOCH_US)


numbers = st.one_of(st.integers(0, 2**64 - 1), st.sampled_from([10**18, 2**63, 2**64 - 1]))


@settings(max_examples=300)
@given(
    payload=st.binary(max_size=60),
    encoding=st.sampled_from([*ENCODINGS, '', 'evt2']),
    time_base=numbers,
    width=st.integers(0, 2**32 - 1),
    height=st.integers(0, 2**32 - 1),
    big=st.booleans(),
)
def test_any_message_decodes_or_is_refused(payload, encoding, time_base, width, height, big):
    message = SimpleNamespace(
        seq=0,
        width=width,
        height=height,
        time_base=time_base,
        encoding=encoding,
        is_bigendian=big,
        events=array('B', payload),
    )
    try:
        packet = decode_message(message)
    except CodecError:
        return
    assert packet.complete_until - packet.start_us <= MAX_SPAN_US
    assert 1000 * packet.complete_until < MAX_TIME_BASE


@pytest.mark.parametrize('encoding', ENCODINGS)
@pytest.mark.parametrize('time_base', [-1, MAX_TIME_BASE, 2**63, 2**64 - 1])
def test_times_beyond_a_stamp_are_refused(encoding: str, time_base: int) -> None:
    payload = encode(make([(5, 1, 1, True)]), encoding).payload
    for octets in (payload, b''):
        with pytest.raises(CodecError):
            decode(octets, encoding, time_base)
    assert decode(payload, encoding, 10**18).events.t[0] >= 10**15


@pytest.mark.parametrize('encoding', ENCODINGS)
def test_payload_types_and_messages(encoding: str) -> None:
    warm_up()
    events = make([(EPOCH_US, 3, y, y % 2 == 0) for y in range(9)])
    packet = encode(events[np.arange(9)], encoding)
    raw = packet.payload.tobytes()
    for payload in (raw, bytearray(raw), memoryview(raw), array('B', raw), packet.payload):
        assert rows_of(decode(payload, encoding, packet.time_base).events) == rows_of(events)
    message = SimpleNamespace(
        width=346,
        height=260,
        time_base=np.uint64(packet.time_base + 999),
        encoding=encoding,
        is_bigendian=False,
        events=array('B', raw),
    )
    assert rows_of(decode_message(message).events) == rows_of(events)
    message.is_bigendian = True
    with pytest.raises(CodecError):
        decode_message(message)


@pytest.mark.parametrize('encoding', ENCODINGS)
def test_strided_and_reversed_views_are_encoded(encoding: str) -> None:
    events = make([(t, t, t, True) for t in range(10)])
    packet = encode(events[::3], encoding)
    assert rows_of(decode(packet.payload, encoding, 0).events) == rows_of(events)[::3]


def test_events_marked_as_not_valid_are_left_out() -> None:
    payload = struct.pack('<IiIi', 0b11, 5, 0b10, 9)
    packet = decode(payload, 'libcaer', 0)
    assert rows_of(packet.events) == [(5, 0, 0, True)]
    assert packet.complete_until == 9
