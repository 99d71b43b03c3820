# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A `geometry_msgs/WrenchStamped` in its serialised form, written in place.

Making a message and having rclpy serialise it takes twice as long as publishing its bytes.
"""

from __future__ import annotations

import struct
from typing import Final

from mixtac_events.serialised_packet import CDR_LITTLE_ENDIAN

_START: Final = 4
_STAMP = struct.Struct('<iI')
_LENGTH = struct.Struct('<I')
_WRENCH = struct.Struct('<6d')
_FORCE_Z: Final = 16
"""Bytes before force.z in a wrench."""
_NUMBER = struct.Struct('<d')


class ForceMessage:
    """Writes forces along z as serialised messages.

    Args:
        frame_id: `header.frame_id` of all of them.
    """

    def __init__(self, frame_id: str) -> None:
        name = frame_id.encode() + b'\0'
        content = _STAMP.pack(0, 0) + _LENGTH.pack(len(name)) + name
        content += bytes(-len(content) % 8)
        self._force_at = _START + len(content) + _FORCE_Z
        zero = _WRENCH.pack(*[0.0] * 6)
        self._bytes = bytearray(CDR_LITTLE_ENDIAN + bytes(2) + content + zero)

    def serialised(self, stamp_us: int, force: float) -> bytes:
        """Return the message.

        Args:
            stamp_us: `header.stamp` [us].
            force: `wrench.force.z` [N].
        """
        seconds, rest = divmod(stamp_us, 1_000_000)
        _STAMP.pack_into(self._bytes, _START, seconds, rest * 1000)
        _NUMBER.pack_into(self._bytes, self._force_at, force)
        return bytes(self._bytes)
