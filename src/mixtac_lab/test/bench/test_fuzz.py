# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A little of the fuzz run, and that it would see what it looks for."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from davis_oracle import Oracle
from decoder_cases import assert_same, decode

from mixtac_driver.davis346.model import Geometry
from mixtac_driver.decode import decoder as decoder_module
from mixtac_driver.decode.decoder import StreamDecoder
from mixtac_lab.bench import fuzz as fuzz_words
from mixtac_lab.bench.fuzz import FuzzError, GuardedDecoder, Tally, run_session


@pytest.mark.parametrize('number', range(6))
def test_sessions_find_nothing(number):
    assert sum(run_session(1, number, 600_000)) >= 600_000


@pytest.mark.parametrize('seed', range(3))
def test_fuzzed_words_decode_as_the_oracle_says(seed):
    rng = np.random.default_rng(seed)
    geometry = Geometry()
    sound = [fuzz_words.valid_stream(rng, geometry, 400) for _ in range(2)]
    assert_same(decode(sound[0], geometry), Oracle(geometry).words(sound[0]))
    for words in (
        fuzz_words.damaged(rng, *sound),
        fuzz_words.mostly_address_words(rng, geometry, 9000),
    ):
        assert_same(decode(words, geometry, capacity=999), Oracle(geometry).words(words))


def test_valid_streams_hold_everything():
    words = fuzz_words.valid_stream(np.random.default_rng(0), Geometry(), 3000)
    decoder = StreamDecoder(Geometry())
    list(decoder.push(words, short_packet=False))
    counters = decoder.counters
    for name in ('events', 'frames', 'imu', 'edges', 'resets', 'wraps'):
        assert getattr(counters, name) > 0
    assert counters.timestamps_backwards == counters.specials_unknown == 0


def spoil(monkeypatch, change):
    """Have the kernel do one thing wrong."""
    sound = decoder_module.decode_words

    def spoilt(*args):
        result = sound(*args)
        if len(args[0]):  # the first call, on nothing, is before the guards stand
            change(args[3], result[1])
        return result

    monkeypatch.setattr(decoder_module, 'decode_words', spoilt)


def outside(buffers, n):
    buffers.row[:n] = 346


def backwards(buffers, n):
    buffers.t[:n] = -1


def uncounted(buffers, n):
    buffers.counters['words'] += 1


def past_the_end(buffers, n):
    np.lib.stride_tricks.as_strided(buffers.row, (len(buffers.row) + 1,))[-1] = 0


@pytest.mark.parametrize('change', [outside, backwards, uncounted, past_the_end])
def test_faults_are_found_and_say_how_to_repeat_them(monkeypatch, change):
    spoil(monkeypatch, change)
    with pytest.raises(FuzzError) as caught:
        list(run_session(1, 2, 300_000))
    assert '--seed 1 --only 2' in str(caught.value)


def test_lost_events_are_found():
    decoder = GuardedDecoder(Geometry(), capacity=64)
    tally = Tally(Geometry())
    for batch in decoder.push(np.array([0x1001, 0x2001], '<u2')):
        tally.take(batch)
    assert tally.events == decoder.counters.events == 1
    assert decoder.intact()


def test_memory_stays_flat():
    rng = np.random.default_rng(0)
    words = fuzz_words.valid_stream(rng, Geometry(), 2000)
    transfers = np.array_split(np.frombuffer(words.tobytes(), np.uint8), 30)
    decoder = StreamDecoder(Geometry())

    def push_all(times):
        for transfer in transfers * times:
            for _ in decoder.push(transfer, short_packet=False):
                pass

    push_all(3)
    tracemalloc.start()
    try:
        push_all(3)
        before = tracemalloc.get_traced_memory()[0]
        push_all(60)
        assert tracemalloc.get_traced_memory()[0] - before < 10_000
    finally:
        tracemalloc.stop()
