# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Fields against the serialisation of ROS 2, lost messages by number, holes in the time."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixtac_core.events.packets import (
    RESTART_STEP,
    CodecError,
    EncodedPacket,
    PacketWriter,
    SequenceCounter,
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
    assert found.stamp_ns == header_stamp_ns(whole()[:12]) == 7 * 10**9 + 5
    for damaged in (b'\0\0' + whole()[2:], *(whole()[:end] for end in range(len(whole())))):
        with pytest.raises(CodecError):
            read_packet(damaged)
    with pytest.raises(CodecError):
        header_stamp_ns(whole()[:10])


@given(st.binary(max_size=200))
def test_noise_gives_a_clear_error_or_bounded_fields(noise):
    try:
        found = read_packet(b'\x00\x01\x00\x00' + noise)
    except CodecError:
        return
    assert len(found.events) <= len(noise)


@pytest.mark.parametrize(
    ('numbers', 'lost', 'repeated', 'restarts', 'continuous'),
    [
        ([5000], 0, 0, 0, True),
        ([7, 8, 12], 3, 0, 0, False),
        ([7, 8, 12, 13], 3, 0, 0, True),
        ([100, 101, 0], 0, 0, 1, False),
        ([3, 4 + RESTART_STEP], 0, 0, 1, False),
        ([3, 4, 4, 5], 0, 1, 0, True),
    ],
)
def test_missing_numbers_are_lost_messages(numbers, lost, repeated, restarts, continuous):
    counter = SequenceCounter()
    assert sum(map(counter.update, numbers)) == lost
    assert counter.received == len(numbers) - repeated
    assert (counter.lost, counter.repeated, counter.restarts) == (lost, repeated, restarts)
    assert counter.continuous == continuous
