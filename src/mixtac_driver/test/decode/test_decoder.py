# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The stream decoder against an independent one, on proper streams and on garbage."""

from __future__ import annotations

import tracemalloc

import numpy as np
from davis_oracle import Oracle
from decoder_cases import (
    SETTINGS,
    Collected,
    assert_same,
    decode,
    geometries,
    streams,
)
from hypothesis import given
from hypothesis import strategies as st

from mixtac_driver.davis346.model import Geometry
from mixtac_driver.decode.decoder import StreamDecoder


def words_of(*words):
    return np.array(words, '<u2').tobytes()


@SETTINGS
@given(
    streams(),
    geometries(),
    st.lists(st.integers(0, 4000), max_size=8),
    st.sampled_from([1, 7, 33, 200]),
    st.sampled_from([0, 1, 100, 20_000]),
)
def test_streams_in_any_pieces_decode_as_the_oracle_says(words, geometry, cuts, capacity, held_us):
    found = decode(words, geometry, cuts, capacity, held_us)
    assert_same(found, Oracle(geometry).words(words))


@SETTINGS
@given(st.binary(max_size=3000), geometries())
def test_garbage_decodes_as_the_oracle_says_and_stays_inside_the_array(data, geometry):
    words = np.frombuffer(data[: len(data) // 2 * 2], '<u2')
    found = decode(words, geometry)
    assert_same(found, Oracle(geometry).words(words))
    width, height = geometry.event_size
    assert all(x < width and y < height for _, _, x, y, _ in found.events)


def test_what_is_not_due_comes_with_the_next_batch():
    decoder = StreamDecoder(Geometry())
    event = [0x1003, 0x3004]
    assert not list(decoder.push(words_of(0x8064, *event), until_us=200))
    (batch,) = decoder.push(words_of(0x80C8, *event), until_us=200)
    assert batch.events.t.tolist() == [100, 200]
    assert batch.time_us == 200


def test_a_reset_makes_everything_due():
    decoder = StreamDecoder(Geometry())
    got = list(decoder.push(words_of(0x8064, 0x1003, 0x3004, 1, 0x8005), until_us=200))
    assert [(batch.resets, batch.time_us, len(batch.events)) for batch in got] == [
        (0, 100, 1),
        (1, 5, 0),
    ]


def test_an_odd_byte_at_the_end_of_a_transfer_is_dropped_and_counted():
    decoder = StreamDecoder(Geometry())
    collected = Collected(decoder).take(decoder.push(words_of(0x1005, 0x2007, 0x2008)[:5]))
    collected.take(decoder.push(words_of(0x2009)))
    assert [event[2:4] for event in collected.events] == [(5, 7), (5, 9)]
    assert decoder.counters.bytes_dropped == 1


def test_transfers_of_events_allocate_little():
    rng = np.random.default_rng(1)
    words = np.where(rng.random(32768) < 0.4, 0x1000, 0x2000) | rng.integers(0, 260, 32768)
    data = words.astype('<u2').tobytes()
    decoder = StreamDecoder(Geometry())

    def push_all():
        return sum(len(batch.events) for _ in range(20) for batch in decoder.push(data))

    push_all()
    tracemalloc.start()
    try:
        assert push_all() > 300_000
        assert tracemalloc.get_traced_memory()[1] < 20_000
    finally:
        tracemalloc.stop()
