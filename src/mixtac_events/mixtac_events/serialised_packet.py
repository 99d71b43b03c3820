# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Reading a serialised `event_camera_msgs/EventPacket` without making the message first.

At 1000 packets a second the conversion of messages to Python objects costs more than everything
that is done with them. A node that subscribes with ``raw=True`` gets the bytes as they came (CDR,
OMG Common Data Representation, little-endian in practice) and reads the fields from them here; the
events stay where they are.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Final

from mixtac_events.errors import CodecError

CDR_LITTLE_ENDIAN: Final = b'\x00\x01'
_START: Final = 4
"""Alignment counts from behind the encapsulation header."""
_STAMP_AND_LENGTH = struct.Struct('<iII')
_SIZE = struct.Struct('<II')
_NUMBERS = struct.Struct('<QQI')
_LENGTH = struct.Struct('<I')


@dataclass(slots=True, eq=False)
class SerialisedPacket:
    """The fields of an `event_camera_msgs/EventPacket`, the events as a view of its bytes.

    Attributes:
        stamp_ns: `header.stamp`: arrival on the host [ns, host clock].
        seq: Number of the packet.
        time_base: See `mixtac_events.packets.EncodedPacket` [ns, camera clock].
        encoding: One of `mixtac_events.codec.ENCODINGS`, or another.
        width: Columns of the sensor.
        height: Rows of the sensor.
        is_bigendian: Of the events.
        events: Encoded bytes.
    """

    stamp_ns: int
    seq: int
    time_base: int
    encoding: str
    width: int
    height: int
    is_bigendian: bool
    events: memoryview


def read_packet(data: bytes) -> SerialisedPacket:
    """Return the fields of a serialised message.

    Args:
        data: What a subscription with ``raw=True`` is given.

    Raises:
        CodecError: The bytes are cut off, or not little-endian CDR.
    """
    if data[:2] != CDR_LITTLE_ENDIAN:
        raise CodecError(
            f'event packet with the representation {data[:2].hex()}: only little-endian CDR (0001)'
            ' can be read'
        )
    try:
        seconds, nanoseconds, length = _STAMP_AND_LENGTH.unpack_from(data, _START)
        at = _aligned(_START + _STAMP_AND_LENGTH.size + length, 4)
        height, width = _SIZE.unpack_from(data, at)
        at = _aligned(at + _SIZE.size, 8)
        seq, time_base, length = _NUMBERS.unpack_from(data, at)
        at += _NUMBERS.size
        encoding = str(data[at : at + length - 1], 'utf8')
        at += length
        is_bigendian = bool(data[at])
        at = _aligned(at + 1, 4)
        (length,) = _LENGTH.unpack_from(data, at)
    except (struct.error, IndexError, UnicodeDecodeError) as error:
        raise CodecError(f'event packet of {len(data)} bytes is damaged: {error}') from error
    events = memoryview(data)[at + _LENGTH.size : at + _LENGTH.size + length]
    if len(events) != length:
        raise CodecError(
            f'event packet of {len(data)} bytes is cut off: {length} bytes of events were announced'
        )
    stamp_ns = seconds * 1_000_000_000 + nanoseconds
    return SerialisedPacket(stamp_ns, seq, time_base, encoding, width, height, is_bigendian, events)


def _aligned(at: int, size: int) -> int:
    """Return the next place that is a multiple of `size` from the start of the content."""
    return at + (_START - at) % size
