# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The output buffer against the simplest model of one: a bytes object."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mixtac_sim.usb.stream import ByteFifo


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
