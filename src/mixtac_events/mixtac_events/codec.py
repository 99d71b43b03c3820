# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Encoding and decoding of event packets, by the name of the encoding.

Every packet stands for itself: nothing is carried over from the packet before it, so that a lost
packet costs its own events only.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np

from mixtac_events import libcaer, libcaer_cmp
from mixtac_events.arrays import Events
from mixtac_events.packets import CodecError, DecodedPacket, EncodedPacket

if TYPE_CHECKING:
    from array import array

    from numpy.typing import NDArray

    Payload = bytes | bytearray | memoryview | array[int] | NDArray[np.uint8]


class Codec(Protocol):
    """What a codec module offers; neither function sees an empty packet."""

    def encode(self, events: Events, complete_until: int | None = None) -> EncodedPacket:
        """Encode events on the camera clock."""

    def decode(
        self, payload: NDArray[np.uint8], time_base: int, *, width: int, height: int
    ) -> DecodedPacket:
        """Decode a payload of whole bytes."""


_CODECS: dict[str, Codec] = {libcaer_cmp.NAME: libcaer_cmp, libcaer.NAME: libcaer}
ENCODINGS = tuple(_CODECS)
"""Names of the encodings, the preferred one first."""
DAVIS346_WIDTH = 346
DAVIS346_HEIGHT = 260


class PacketMessage(Protocol):
    """The fields of `event_camera_msgs/EventPacket` that decoding needs."""

    width: int
    height: int
    time_base: int
    encoding: str
    is_bigendian: bool

    @property
    def events(self) -> Payload:
        """Encoded bytes."""


def encode(
    events: Events, encoding: str = libcaer_cmp.NAME, *, complete_until: int | None = None
) -> EncodedPacket:
    """Encode events as one packet.

    Args:
        events: Events on the camera clock [us], not negative, times not decreasing; may be empty.
        encoding: One of `ENCODINGS`.
        complete_until: Camera clock [us]: no event before this time will follow. None: the time
            of the last event. `libcaer` can carry it in empty packets only.

    Returns:
        The packet. Without events it has no payload and its `time_base` is `complete_until`.

    Raises:
        CodecError: Unknown encoding, events it cannot carry, an empty packet without
            `complete_until`, or a `complete_until` before the last event.
    """
    codec = _codec(encoding)
    if len(events) == 0:
        return EncodedPacket(encoding, _empty_time(complete_until) * 1000, np.empty(0, np.uint8))
    if events.t[0] < 0:
        raise CodecError(
            f'first event is at {events.t[0]} us: packets hold times after the epoch; add the '
            "origin of the camera's clock first"
        )
    if complete_until is not None and complete_until < events.t[-1]:
        raise CodecError(
            f'complete_until = {complete_until} us lies before the last event at '
            f'{events.t[-1]} us: give the later of both'
        )
    return codec.encode(_contiguous(events), complete_until)


def decode(
    payload: Payload,
    encoding: str,
    time_base: int,
    *,
    width: int = DAVIS346_WIDTH,
    height: int = DAVIS346_HEIGHT,
) -> DecodedPacket:
    """Decode one packet.

    Args:
        payload: Encoded bytes: anything with a buffer, for example the field `events` of a message.
        encoding: One of `ENCODINGS`.
        time_base: Field of the same name, camera clock [ns].
        width: Columns of the sensor; events outside are an error.
        height: Rows of the sensor.

    Returns:
        Events on the camera clock, parts of a microsecond in `time_base` dropped.

    Raises:
        CodecError: Unknown encoding, truncated or damaged payload, or an event outside the sensor.
    """
    codec = _codec(encoding)
    data = np.frombuffer(payload, np.uint8)
    # One type for bytes, arrays and read-only views: the compiled decoders exist only once.
    data.flags.writeable = False
    if data.size == 0:
        return DecodedPacket(Events.empty(), int(time_base) // 1000)
    return codec.decode(data, int(time_base), width=int(width), height=int(height))


def decode_message(message: PacketMessage) -> DecodedPacket:
    """Decode an `event_camera_msgs/EventPacket`.

    Args:
        message: The message; its own width and height bound the coordinates.

    Raises:
        CodecError: As `decode`, and for big-endian payloads.
    """
    if message.is_bigendian:
        raise CodecError('event packet is big-endian: record or publish it little-endian')
    return decode(
        message.events,
        message.encoding,
        message.time_base,
        width=message.width,
        height=message.height,
    )


def warm_up() -> None:
    """Compile (or load) all encoders and decoders, so that the first packet is not late."""
    one = Events(
        np.zeros(1, np.int64), np.zeros(1, np.uint16), np.zeros(1, np.uint16), np.ones(1, np.bool_)
    )
    for encoding in ENCODINGS:
        packet = encode(one, encoding, complete_until=1)
        decode(packet.payload, encoding, packet.time_base)


def _codec(encoding: str) -> Codec:
    try:
        return _CODECS[encoding]
    except KeyError:
        raise CodecError(
            f'unknown encoding {encoding!r}: known are {", ".join(ENCODINGS)}'
        ) from None


def _empty_time(complete_until: int | None) -> int:
    if complete_until is None or complete_until < 0:
        raise CodecError(
            f'an empty packet needs complete_until [us] >= 0, got {complete_until}: it is all that '
            'the packet says'
        )
    return int(complete_until)


def _contiguous(events: Events) -> Events:
    """Return the events in the one memory layout that the encoders are compiled for."""
    return Events(
        np.ascontiguousarray(events.t, np.int64),
        np.ascontiguousarray(events.x, np.uint16),
        np.ascontiguousarray(events.y, np.uint16),
        np.ascontiguousarray(events.polarity, np.bool_),
    )
