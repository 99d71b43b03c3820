# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Fields read from bytes against the serialisation of ROS 2 and of rosbags."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixtac_core.events.packets import (
    CodecError,
    EncodedPacket,
    PacketWriter,
    header_stamp_ns,
    read_packet,
)

names = st.text(st.characters(min_codepoint=32, max_codepoint=0x3FF), max_size=20)


@pytest.fixture(scope='module')
def ros():
    pytest.importorskip('rclpy', reason='needs ROS 2')
    pytest.importorskip('event_camera_msgs', reason='needs the built workspace')
    from event_camera_msgs.msg import EventPacket
    from rclpy.serialization import serialize_message

    def serialise(frame, encoding, events, stamp, seq, time_base, size, big):
        message = EventPacket(seq=seq, time_base=time_base, encoding=encoding, is_bigendian=big)
        message.header.frame_id = frame
        message.header.stamp.sec, message.header.stamp.nanosec = stamp
        message.width, message.height = size
        message.events.frombytes(events)
        return serialize_message(message)

    return serialise


@given(
    frame=names,
    encoding=names,
    events=st.binary(max_size=40),
    stamp=st.tuples(st.integers(0, 2**31 - 1), st.integers(0, 999_999_999)),
    seq=st.integers(0, 2**64 - 1),
    time_base=st.integers(0, 2**63 - 1),
    size=st.tuples(st.integers(0, 2**32 - 1), st.integers(0, 2**32 - 1)),
    big=st.booleans(),
)
def test_fields_are_read_and_written_as_by_ros(
    ros, frame, encoding, events, stamp, seq, time_base, size, big
):
    found = read_packet(ros(frame, encoding, events, stamp, seq, time_base, size, big))
    stamp_ns = stamp[0] * 10**9 + stamp[1]
    assert (found.stamp_ns, found.seq, found.time_base) == (stamp_ns, seq, time_base)
    assert (found.width, found.height) == size
    assert (found.encoding, found.is_bigendian) == (encoding, big)
    assert bytes(found.events) == events
    writer = PacketWriter(frame, size)
    writer.write(EncodedPacket(1, np.ones(3, np.uint8)), 1, 1)
    written = writer.write(EncodedPacket(time_base, np.frombuffer(events, np.uint8)), seq, stamp_ns)
    expected = ros(frame, 'libcaer_cmp', events, stamp, seq, time_base, size, False)
    assert len(written) == len(expected)
    # Not byte by byte: ROS leaves what aligns the fields as it is in memory.
    assert deserialised(written) == deserialised(expected)


def deserialised(data: bytes):
    from event_camera_msgs.msg import EventPacket
    from rclpy.serialization import deserialize_message

    return deserialize_message(data, EventPacket)


def whole() -> bytes:
    """Return a message by the rules of the standard, written out by hand."""
    header = struct.pack('<iII', 7, 5, 4) + b'cam\0'
    numbers = struct.pack('<II', 260, 346) + struct.pack('<QQ', 3, 9_000)
    text = struct.pack('<I', 8) + b'libcaer\0'
    return (
        b'\x00\x01\x00\x00' + header + numbers + text + b'\0\0\0\0' + struct.pack('<I', 2) + b'ab'
    )


def test_a_message_by_hand():
    found = read_packet(whole())
    assert (found.width, found.height, found.seq, found.time_base) == (346, 260, 3, 9000)
    assert found.encoding == 'libcaer'
    assert bytes(found.events) == b'ab'
    for damaged in (b'\0\0' + whole()[2:], *(whole()[:end] for end in range(len(whole())))):
        with pytest.raises(CodecError):
            read_packet(damaged)


@given(st.binary(max_size=200))
def test_noise_gives_a_clear_error_or_bounded_fields(noise):
    try:
        found = read_packet(b'\x00\x01\x00\x00' + noise)
    except CodecError:
        return
    assert len(found.events) <= len(noise)


@given(
    seconds=st.integers(-(2**31), 2**31 - 1),
    nanoseconds=st.integers(0, 2**32 - 1),
    order=st.sampled_from('<>'),
)
def test_the_stamp_is_read_in_both_byte_orders(seconds, nanoseconds, order):
    start = b'\x00\x01\x00\x00' if order == '<' else b'\x00\x00\x00\x00'
    data = start + struct.pack(order + 'iI', seconds, nanoseconds) + b'rest'
    assert header_stamp_ns(data) == seconds * 10**9 + nanoseconds
    with pytest.raises(CodecError):
        header_stamp_ns(data[:10])
