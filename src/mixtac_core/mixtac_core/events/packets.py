# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Packets of events without ROS: encoded, decoded, read from serialised messages, written, counted.

At 1000 packets per second, converting messages to Python objects costs more than processing them.
A node that subscribes with ``raw=True`` gets the serialised bytes (CDR, OMG Common Data
Representation, little-endian in practice) and reads the fields from them here without copying the
events. The driver writes these bytes itself, and publishes them as they are.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from mixtac_core.events.errors import MixtacError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from mixtac_core.events.arrays import Events


LIBCAER_CMP: Final = 'libcaer_cmp'
"""The encoding of all packets that are written; see `mixtac_core.events.libcaer_cmp`."""


class CodecError(MixtacError):
    """Events that an encoding cannot carry, or a payload that is not valid in its encoding."""


@dataclass(frozen=True, slots=True, eq=False)
class EncodedPacket:
    """Values of the fields of an `event_camera_msgs/EventPacket` of the same names.

    Attributes:
        time_base: Time of the first event [ns, camera clock]. In an empty packet it is the time up
            to which the stream is known to be complete.
        payload: Encoded bytes, ``uint8``, little-endian.
        encoding: Name of the encoding.
    """

    time_base: int
    payload: NDArray[np.uint8]
    encoding: str = LIBCAER_CMP


@dataclass(frozen=True, slots=True, eq=False)
class DecodedPacket:
    """The content of one packet.

    Attributes:
        events: Events on the camera clock, in the order of the packet.
        complete_until: Camera clock [us]: the stream holds no further event before this time, so
            that windows ending here can be closed at once.
    """

    events: Events
    complete_until: int

    @property
    def start_us(self) -> int:
        """Time of the first event, or `complete_until` without events; camera clock [us]."""
        return int(self.events.t[0]) if len(self.events) else self.complete_until


CDR_LITTLE_ENDIAN: Final = b'\x00\x01'
_START: Final = 4
"""Size of the encapsulation header; alignment counts from its end."""
_SIZE = struct.Struct('<II')
_NUMBERS = struct.Struct('<QQI')
_LENGTH = struct.Struct('<I')
_STAMP = struct.Struct('<iI')


@dataclass(slots=True, eq=False)
class SerialisedPacket:
    """The fields of an `event_camera_msgs/EventPacket`, the events as a view of its bytes.

    Attributes:
        stamp_ns: `header.stamp`: arrival on the host [ns, host clock].
        seq: Number of the packet.
        time_base: See `mixtac_core.events.packets.EncodedPacket` [ns, camera clock].
        encoding: Name of the encoding of the events.
        width: Columns of the sensor.
        height: Rows of the sensor.
        is_bigendian: Byte order of the events.
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
    stamp_ns = header_stamp_ns(data)
    try:
        at = _START + _STAMP.size
        (length,) = _LENGTH.unpack_from(data, at)
        at = _aligned(at + _LENGTH.size + length, 4)
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
    return SerialisedPacket(stamp_ns, seq, time_base, encoding, width, height, is_bigendian, events)


class PacketWriter:
    """Writes the serialised messages that `read_packet` reads. For one thread.

    Args:
        frame_id: Frame of the camera.
        size: Columns and rows of the sensor.
    """

    def __init__(self, frame_id: str, size: tuple[int, int]) -> None:
        width, height = size
        frame, name = (text.encode() + b'\0' for text in (frame_id, LIBCAER_CMP))
        head = CDR_LITTLE_ENDIAN + bytes(2) + _STAMP.pack(0, 0) + _LENGTH.pack(len(frame)) + frame
        head = head.ljust(_aligned(len(head), 4), b'\0') + _SIZE.pack(height, width)
        head = head.ljust(_aligned(len(head), 8), b'\0')
        self._numbers_at = len(head)
        little_endian = bytes(1)
        head += _NUMBERS.pack(0, 0, len(name)) + name + little_endian
        head = head.ljust(_aligned(len(head), 4), b'\0')
        self._length_at = len(head)
        self._head = bytearray(head + _LENGTH.pack(0))

    def write(self, packet: EncodedPacket, seq: int, stamp_ns: int) -> bytes:
        """Return the message of a packet.

        Args:
            packet: The packet.
            seq: Its number.
            stamp_ns: Its arrival on the host [ns, host clock].
        """
        head = self._head
        _STAMP.pack_into(head, _START, *divmod(stamp_ns, 1_000_000_000))
        struct.pack_into('<QQ', head, self._numbers_at, seq, packet.time_base)
        _LENGTH.pack_into(head, self._length_at, len(packet.payload))
        return b''.join((head, packet.payload.data))


def _aligned(at: int, size: int) -> int:
    """Return the next place that is a multiple of `size` from the start of the content."""
    return at + (_START - at) % size


def header_stamp_ns(data: bytes) -> int:
    """Return the stamp [ns, clock of the topic] of a message that begins with a header.

    Args:
        data: CDR with its encapsulation header of 4 bytes (OMG XTypes 1.3, 7.4.3.5).

    Raises:
        CodecError: The bytes are cut off, or not little-endian CDR.
    """
    if data[:2] != CDR_LITTLE_ENDIAN or len(data) < _START + _STAMP.size:
        raise CodecError(
            f'message of {len(data)} bytes with the representation {data[:2].hex()}: only whole '
            'messages in little-endian CDR (0001) can be read'
        )
    seconds, nanoseconds = _STAMP.unpack_from(data, _START)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


RESTART_STEP = 1_000_000
"""A larger step forward is a restart of the sender: 1000 s without packets at 1 kHz."""


class SequenceCounter:
    """Counts received, lost and repeated messages by their numbers, and restarts of the sender.

    Attributes:
        received: Messages seen, without repetitions.
        lost: Messages missing between them. Messages missing around a restart are not counted,
            because their number is unknown.
        repeated: Messages with the number of the one before.
        restarts: Times that the numbers went back, or forward by more than RESTART_STEP.
        continuous: False if something is missing directly before the latest message: a loss or
            a restart. True after the first message.
    """

    def __init__(self) -> None:
        self.received = self.lost = self.repeated = self.restarts = 0
        self.continuous = True
        self._last: int | None = None

    def update(self, seq: int) -> int:
        """Count a message.

        Args:
            seq: Its number; the sender counts up by one.

        Returns:
            The number of messages missing before it: 0 for the first, after a restart and for a
            repetition, never negative.
        """
        seq = int(seq)
        step = 1 if self._last is None else seq - self._last
        self._last = seq
        self.continuous = step in {0, 1}
        if step == 0:
            self.repeated += 1
            return 0
        self.received += 1
        if not 0 < step <= RESTART_STEP:
            self.restarts += 1
            return 0
        self.lost += step - 1
        return step - 1
