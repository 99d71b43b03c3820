# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The output buffer against the simplest model of one: a bytes object."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mixtac_sim.usb.stream import ByteFifo

actions = st.lists(
    st.one_of(
        st.lists(st.integers(0, 0xFFFF), max_size=30).map(lambda words: ('push', words)),
        st.integers(0, 100).map(lambda limit: ('pop', limit)),
    ),
    max_size=40,
)


def pop(fifo, limit):
    """Remove and return at most ``limit`` bytes, whole words only."""
    out = np.empty(min(limit & ~1, len(fifo)), np.uint8)
    fifo.pop_into(out)
    return out.tobytes()


@given(st.integers(1, 40), actions)
def test_behaves_like_a_bounded_bytes_object(capacity, todo):
    fifo, model = ByteFifo(2 * capacity), b''
    for action, value in todo:
        if action == 'push':
            data = np.array(value, '<u2').tobytes()
            fits = len(model) + len(data) <= 2 * capacity
            assert fifo.push(np.array(value, np.uint16)) == fits
            model += data if fits else b''
        else:
            count = min(value // 2 * 2, len(model))
            assert pop(fifo, value) == model[:count]
            model = model[count:]
        assert (len(fifo), fifo.free) == (len(model), 2 * capacity - len(model))


def test_clear_forgets():
    fifo = ByteFifo(8)
    fifo.push(np.array([1, 2], np.uint16))
    fifo.clear()
    assert pop(fifo, 8) == b''


@given(st.integers(1, 40), st.lists(st.integers(0, 30), max_size=30))
def test_ring_gives_whole_words_in_order_whatever_is_asked(words, lengths):
    fifo = ByteFifo(64)
    expected, sent = [], 0
    for length in lengths:
        batch = np.arange(sent, sent + words, dtype=np.uint16)
        if fifo.push(batch):
            expected += batch.tolist()
            sent += words
        out = np.zeros(length, np.uint8)
        count = fifo.pop_into(out)
        assert count <= length
        whole = out[: count // 2 * 2].view('<u2').tolist()
        assert whole == expected[: len(whole)]
        del expected[: len(whole) + count % 2]
        assert len(fifo) == 2 * len(expected)
