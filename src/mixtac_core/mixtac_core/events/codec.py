# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Encoding and decoding of event packets.

Packets of `libcaer_cmp` and `libcaer` are independent of each other: when a packet is lost, only
its own events are lost.
"""

from __future__ import annotations

from array import array
from typing import Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mixtac_core.events import foreign, libcaer_cmp
from mixtac_core.events.arrays import Events
from mixtac_core.events.packets import LIBCAER_CMP, CodecError, DecodedPacket, EncodedPacket

# In quotes: Python 3.11 cannot subscript array.
Payload: TypeAlias = 'bytes | bytearray | memoryview | array[int] | NDArray[np.uint8]'
PacketMessage: TypeAlias = Any
"""An `event_camera_msgs/EventPacket` of rclpy or rosbags, or a `SerialisedPacket`."""
MAX_TIME_BASE: Final = (1 << 31) * 1_000_000_000
"""Times from here on [ns] do not fit into ROS stamps."""
MAX_SPAN_US: Final = 1 << 24
"""Longest packet of a message [us], the most that `libcaer_cmp` holds. It bounds the number of
windows that one packet can close."""
_TYPES = (np.int64, np.uint16, np.uint16, np.bool_)


def encode(events: Events, *, complete_until: int) -> EncodedPacket:
    """Encode events as one packet of `libcaer_cmp`.

    Args:
        events: Events on the camera clock [us], not negative, times not decreasing; may be empty.
        complete_until: Camera clock [us], not before the last event: no event before this time
            will follow.

    Returns:
        The packet. Without events it has no payload and its `time_base` is `complete_until`.

    Raises:
        CodecError: Events that it cannot carry.
    """
    if not len(events):
        return EncodedPacket(complete_until * 1000, np.empty(0, np.uint8))
    # The encoder is compiled for one memory layout.
    arrays: Any = map(np.ascontiguousarray, events.fields, _TYPES)
    words = np.empty(4 * len(events) + 2, np.uint16)
    used = libcaer_cmp.encode_words(*arrays, complete_until, words)
    if used < 0:
        at = -1 - used
        raise CodecError(
            f'event {at} at ({events.x[at]}, {events.y[at]}), {events.t[at]} us: libcaer_cmp holds '
            f'events in the order of time, over {libcaer_cmp.MAX_SPAN_US} us, with coordinates up '
            f'to {libcaer_cmp.MAX_COORDINATE}'
        )
    return EncodedPacket(int(events.t[0]) * 1000, words[:used].view(np.uint8).copy())


def decode(
    payload: Payload, encoding: str, time_base: int, *, width: int, height: int
) -> DecodedPacket:
    """Decode one packet.

    Args:
        payload: Encoded bytes: anything with a buffer, for example the field `events` of a message.
        encoding: `libcaer_cmp` or `libcaer`.
        time_base: Field of the same name, camera clock [ns].
        width: Columns of the sensor; events outside are an error.
        height: Rows of the sensor.

    Returns:
        Events on the camera clock, sub-microsecond part of `time_base` discarded.

    Raises:
        CodecError: Another encoding, truncated or damaged payload, an event outside the sensor,
            or a `time_base` that is negative or too large.
    """
    if encoding not in (LIBCAER_CMP, foreign.LIBCAER):
        raise CodecError(
            f'unknown encoding {encoding!r}: known are {LIBCAER_CMP} and {foreign.LIBCAER};'
            f' {foreign.EVT3} is read from recordings only'
        )
    start_us = int(time_base) // 1000
    if not 0 <= time_base < MAX_TIME_BASE:
        raise CodecError(f'time_base {time_base} ns is outside 0 .. {MAX_TIME_BASE} ns')
    # A copy has one type for all buffers: the decoders are compiled for aligned arrays only.
    data = np.frombuffer(payload, np.uint8).copy()
    if data.size == 0:
        return DecodedPacket(Events.empty(), start_us)
    read = foreign.decode_libcaer if encoding == foreign.LIBCAER else _decode_libcaer_cmp
    return read(data, start_us, width=int(width), height=int(height))


def _decode_libcaer_cmp(
    payload: NDArray[np.uint8], start_us: int, *, width: int, height: int
) -> DecodedPacket:
    if payload.size % 2:
        raise CodecError(
            f'libcaer_cmp payload of {payload.size} bytes: truncated, a word has 2 bytes'
        )
    words = payload.view(np.uint16)
    count = found = libcaer_cmp.count_events(words)
    events = Events.empty(max(count, 0))
    if count >= 0:
        found = libcaer_cmp.decode_words(words, start_us, width, height, *events.fields)
    if found < 0:
        at = -1 - found
        raise CodecError(
            f'libcaer_cmp word {at} (0x{int(words[at]):04x}) is damaged, outside the sensor of '
            f'{width} x {height}, or the packet lost its start'
        )
    return DecodedPacket(events, start_us + found)


def decode_message(message: PacketMessage) -> DecodedPacket:
    """Decode an `event_camera_msgs/EventPacket`.

    Args:
        message: The message; its own width and height bound the coordinates.

    Raises:
        CodecError: As `decode`, and for big-endian payloads and packets over `MAX_SPAN_US`.
    """
    if message.is_bigendian:
        raise CodecError('event packet is big-endian: record or publish it little-endian')
    size = {'width': message.width, 'height': message.height}
    return _bounded(decode(message.events, message.encoding, message.time_base, **size))


class StreamDecoder:
    """Decodes the messages of one topic of a recording in their order; each pass needs its own.

    It reads `evt3` as well, whose packets continue the ones before them.

    Attributes:
        timed: Whether the times of the latest packet are valid; times of `evt3` are not before the
            first complete one.
    """

    def __init__(self) -> None:
        self.timed = True
        self._evt3 = foreign.Evt3Decoder()

    def decode(self, message: PacketMessage) -> DecodedPacket:
        """Decode the next message; see `decode_message`.

        Raises:
            CodecError: As `decode_message`.
        """
        if message.encoding != foreign.EVT3:
            return decode_message(message)
        data = np.frombuffer(message.events, np.uint8).copy()
        size = {'width': int(message.width), 'height': int(message.height)}
        packet = _bounded(self._evt3.decode(data, **size))
        self.timed = self._evt3.timed
        return packet


def _bounded(packet: DecodedPacket) -> DecodedPacket:
    span_us, end_us = packet.complete_until - packet.start_us, packet.complete_until
    if span_us > MAX_SPAN_US or 1000 * end_us >= MAX_TIME_BASE:
        raise CodecError(
            f'event packet of {span_us} us ends at {end_us} us: packets last at most {MAX_SPAN_US} '
            'us and end before 2038'
        )
    return packet


def warm_up() -> None:
    """Compile (or load) encoder and decoder, so that the first packet is not late."""
    one = Events(
        np.zeros(1, np.int64), np.zeros(1, np.uint16), np.zeros(1, np.uint16), np.ones(1, np.bool_)
    )
    packet = encode(one, complete_until=1)
    decode(packet.payload, packet.encoding, packet.time_base, width=1, height=1)
