# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The few fields that a recorder reads of serialised messages (CDR), without deserialising them."""

from __future__ import annotations

import struct

_ENCAPSULATION = 4
_STAMP = {1: struct.Struct('<iI'), 0: struct.Struct('>iI')}
_LENGTH = {1: struct.Struct('<I'), 0: struct.Struct('>I')}
_NUMBER = {1: struct.Struct('<Q'), 0: struct.Struct('>Q')}


def header_stamp_ns(data: bytes) -> int:
    """Return the stamp [ns, clock of the topic] of a message that begins with a header.

    Args:
        data: CDR with its encapsulation header of 4 bytes (OMG XTypes 1.3, 7.4.3.5).
    """
    seconds, nanoseconds = _STAMP[data[1] & 1].unpack_from(data, _ENCAPSULATION)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


def packet_sequence(data: bytes) -> int:
    """Return `seq` of a serialised `event_camera_msgs/EventPacket`.

    Args:
        data: As above; header, height and width come before the number, which is aligned to 8.
    """
    order = data[1] & 1
    (length,) = _LENGTH[order].unpack_from(data, _ENCAPSULATION + 8)
    end = 12 + length
    sizes = (end + 3) // 4 * 4
    number = (sizes + 8 + 7) // 8 * 8
    (value,) = _NUMBER[order].unpack_from(data, _ENCAPSULATION + number)
    return int(value)
