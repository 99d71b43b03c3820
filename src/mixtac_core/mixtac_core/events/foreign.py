# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Encodings of `event_camera_msgs/EventPacket` that are read and never written.

`libcaer` has eight bytes per event, little-endian: ``uint32`` data, then ``int32`` time. In the
data, bit 0 marks a valid event, bit 1 the polarity, bits 2 to 16 the row, bits 17 to 31 the column.
The time holds the low 31 bits of the camera time [us]; `time_base` [ns] is the rest of the camera
time of the first event, times 1000. Where the low bits roll over inside a packet (every
35.8 minutes), later events lie 2^31 us later.

`evt3` is the stream of Prophesee's sensors (EVT 3.0,
https://docs.prophesee.ai/stable/data/encoding_formats/evt3.html), divided into packets at any
point. Its words have 16 bits; the upper four are the type. Time and row are valid until the next
word that changes them, also across packets. Times have 24 bits [us] and roll over every 16.8 s.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mixtac_core.events.arrays import Events
from mixtac_core.events.packets import CodecError, DecodedPacket

LIBCAER: Final = 'libcaer'
EVT3: Final = 'evt3'
_COORDINATE: Final = (1 << 15) - 1
"""Mask of the coordinates of `libcaer`."""
_SAME_TURN_US: Final = 1 << 30
"""A time of `libcaer` that goes back by at least this much has rolled over [us]."""


def decode_libcaer(
    payload: NDArray[np.uint8], start_us: int, *, width: int, height: int
) -> DecodedPacket:
    """Decode a packet of the encoding `libcaer` that is not empty.

    Events that the camera library has marked as not valid are left out.

    Args:
        payload: Encoded bytes.
        start_us: `time_base` in microseconds, camera clock.
        width: Columns of the sensor.
        height: Rows of the sensor.

    Raises:
        CodecError: Length not a multiple of 8, negative time, event outside the sensor.
    """
    if payload.size % 8:
        raise CodecError(
            f'libcaer payload of {payload.size} bytes: truncated, an event has 8 bytes'
        )
    words = payload.view([('data', np.uint32), ('t', np.int32)])
    low = words['t'].astype(np.int64)
    if (low < 0).any():
        raise CodecError(
            f'libcaer event {low.argmin()} has a negative time: not libcaer, or damaged'
        )
    turns = np.cumsum(np.diff(low, prepend=low[:1]) <= -_SAME_TURN_US)
    t = start_us + low + (turns << 31)
    data = words['data']
    events = Events(
        t,
        (data >> 17).astype(np.uint16),
        (data >> 2 & _COORDINATE).astype(np.uint16),
        (data & 2).astype(np.bool_),
    )[(data & 1).astype(np.bool_)]
    if (events.x >= width).any() or (events.y >= height).any():
        raise CodecError(
            f'libcaer packet has an event outside the sensor of {width} x {height}: give the width '
            'and height of the camera that made the packet'
        )
    return DecodedPacket(events, int(t[-1]))


_ROW: Final = 0x0
_EVENT: Final = 0x2
_BASE: Final = 0x3
_VECTOR_12: Final = 0x4
_VECTOR_8: Final = 0x5
_TIME_LOW: Final = 0x6
_TIME_HIGH: Final = 0x8
_ROLL_OVER_US: Final = 1 << 24
_BACK_US: Final = 10 << 12
"""A time that goes back by no more is not a roll-over [us]."""
_UPPER: Final = 1
_WHOLE: Final = 3


class Evt3Decoder:
    """Decodes the packets of one `evt3` stream, in their order."""

    def __init__(self) -> None:
        # Upper and lower bits of the time, which of both are known, row, next column, polarity.
        self._state = (0, 0, 0, 0, 0, 0)

    @property
    def timed(self) -> bool:
        """Whether a packet has held the upper bits of the time, which few of them do."""
        return bool(self._state[2])

    def decode(self, payload: NDArray[np.uint8], *, width: int, height: int) -> DecodedPacket:
        """Decode the next packet.

        Events before the first time of the stream, or outside the sensor, are left out, as are
        triggers and reports of the camera on itself.

        Args:
            payload: Encoded bytes.
            width: Columns of the sensor.
            height: Rows of the sensor.

        Raises:
            CodecError: An odd number of bytes.
        """
        if payload.size % 2:
            raise CodecError(f'evt3 payload of {payload.size} bytes: truncated, a word has 2 bytes')
        words = payload.view(np.uint16)
        events = Events.empty(12 * words.size)
        count, self._state = _decode_evt3(words, self._state, width, height, *events.fields)
        events = events[:count].copy()
        if count and (np.diff(events.t) < 0).any():
            events = events[np.argsort(events.t, kind='stable')]
        now_us = int(self._state[0] | self._state[1])
        return DecodedPacket(events, max(now_us, int(events.t[-1])) if count else now_us)


@njit(cache=True, nogil=True)
def _decode_evt3(  # noqa: C901, PLR0912  (one branch per kind of word)
    words: NDArray[np.uint16],
    state: tuple[Any, ...],
    width: int,
    height: int,
    t: NDArray[np.int64],
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    polarity: NDArray[np.bool_],
) -> tuple[int, tuple[int, ...]]:
    """Fill the event arrays; return the number of events and the new state."""
    n = 0
    high, low, known, row, base, base_on = state
    for word in words:
        kind, value = np.int64(word) >> 12, np.int64(word) & 0xFFF
        if kind == _TIME_HIGH:
            new = (high & ~np.int64(_ROLL_OVER_US - 1)) | value << 12
            if high - new > _BACK_US:
                new += _ROLL_OVER_US
            if new != high:
                # The lower half is not known yet: the time is this, or later.
                low = 0
            high = new
            known |= _UPPER
        elif kind == _TIME_LOW:
            low = value
            if known:
                known = _WHOLE
        elif kind == _ROW:
            row = value & 0x7FF
        elif kind == _BASE:
            base, base_on = value & 0x7FF, value >> 11
        elif kind in (_EVENT, _VECTOR_8, _VECTOR_12):
            column, bits, many, on = value & 0x7FF, np.int64(1), 1, value >> 11
            if kind != _EVENT:
                many = 8 if kind == _VECTOR_8 else 12
                column, bits, on = base, value & ((1 << many) - 1), base_on
                base += many
            if known != _WHOLE or row >= height:
                continue
            for bit in range(many):
                if bits >> bit & 1 and column + bit < width:
                    t[n] = high | low
                    x[n] = column + bit
                    y[n] = row
                    polarity[n] = on != 0
                    n += 1
    return n, (high, low, known, row, base, base_on)
