# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The queue of transfers: order, bound, and the time that passed in what it throws away."""

from __future__ import annotations

import struct

from hypothesis import given
from hypothesis import strategies as st

from mixtac_driver.usb.transport import TransferQueue


def words(*values):
    return struct.pack(f'<{len(values)}H', *values)


def test_a_full_queue_drops_the_newest_counts_them_and_keeps_the_time():
    queue = TransferQueue(8)
    for k in range(10):
        queue.put(words(0x8000 | k, 0x7000 | k), k, short_packet=True)
    counters = queue.counters
    assert (counters.transfers, counters.size) == (10, 40)
    assert (counters.dropped_transfers, counters.dropped_size) == (8, 32)
    assert (counters.queued_size, counters.most_queued_size) == (8, 8)
    assert [queue.pop().arrival_ns for _ in range(2)] == [0, 1]
    queue.put(words(0x8001), 11, short_packet=True)
    after = queue.pop()
    assert (after.gap.size, after.gap.wraps) == (32, sum(range(2, 10)))
    queue.put(words(0x8002), 12, short_packet=True)
    assert queue.pop().gap.size == 0


@given(
    st.integers(1, 64),
    st.lists(st.one_of(st.binary(min_size=1, max_size=16), st.none()), max_size=80),
)
def test_what_goes_in_comes_out_or_is_counted(limit, steps):
    queue, out, dropped = TransferQueue(limit), b'', 0
    sent = b''.join(step for step in steps if step)
    for step in [*steps, *[None] * len(steps)]:
        if step is not None:
            queue.put(step, 0, short_packet=False)
            assert queue.counters.queued_size <= limit
            continue
        transfer = queue.pop()
        if transfer is not None:
            dropped += transfer.gap.size
            out += transfer.data
    counters = queue.counters
    assert counters.queued_size == len(queue) == 0
    assert len(out) + counters.dropped_size == len(sent) == counters.size
    assert dropped <= counters.dropped_size
