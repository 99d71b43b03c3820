# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Fields read of serialised messages, against a serialiser that is not ours."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from mixtac_events.packets import header_stamp_ns, packet_sequence


@given(
    seq=st.integers(0, 2**64 - 1),
    frame=st.text('abc/_é', max_size=20),
    sec=st.integers(-(2**31), 2**31 - 1),
    nanosec=st.integers(0, 2**32 - 1),
    big=st.booleans(),
)
def test_number_and_stamp_are_those_that_were_written(packet, seq, frame, sec, nanosec, big):
    data = packet(seq, frame, 'libcaer_cmp', sec, nanosec, big=big)
    assert packet_sequence(data) == seq
    assert header_stamp_ns(data) == sec * 10**9 + nanosec
