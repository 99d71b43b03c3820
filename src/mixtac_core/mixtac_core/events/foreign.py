# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The encoding `evt3` of other event cameras, which is read and never written.

It is the stream of Prophesee's sensors, cut anywhere (EVT 3.0,
https://docs.prophesee.ai/stable/data/encoding_formats/evt3.html): words of 16 bits whose upper four
name their kind. Time and row hold until they change, also from packet to packet. Times have 24 bits
[us] and roll over every 16.8 s.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mixtac_core.events.arrays import Events
from mixtac_core.events.packets import CodecError, DecodedPacket

EVT3: Final = 'evt3'
_ROW, _EVENT, _BASE, _VECTOR_12, _VECTOR_8 = 0x0, 0x2, 0x3, 0x4, 0x5
_TIME_LOW, _TIME_HIGH = 0x6, 0x8
_IGNORED = (0x7, 0xA, 0xE, 0xF)
"""Triggers, and what the camera reports of itself."""
_ROLL_OVER = 1 << 24
_BACK = 10 << 12
"""A time that goes back by no more is not a roll-over [us]."""
_HIGH, _LOW, _KNOWN, _Y, _X, _POLARITY = range(6)
"""Places in the state: upper and lower bits of the time, what is known of it, row, next column."""


class Evt3Decoder:
    """Decodes the packets of one `evt3` stream, in their order."""

    def __init__(self) -> None:
        self._state = np.zeros(6, np.int64)

    @property
    def timed(self) -> bool:
        """Whether a packet has told the upper bits of the time, which few of them may hold."""
        return bool(self._state[_KNOWN] & 1)

    def decode(self, payload: NDArray[np.uint8], *, width: int, height: int) -> DecodedPacket:
        """Decode the next packet.

        Events before the first time of the stream, or outside the sensor, are left out.

        Args:
            payload: Encoded bytes.
            width: Columns of the sensor.
            height: Rows of the sensor.

        Raises:
            CodecError: An odd number of bytes, or a word of an unknown kind.
        """
        if payload.size % 2:
            raise CodecError(f'evt3 payload of {payload.size} bytes: truncated, a word has 2 bytes')
        words = payload.view(np.uint16)
        size = _most_events(words)
        events = Events.empty(size)
        arrays = (events.t, events.x, events.y, events.polarity)
        count, fault = _decode_words(words, self._state, width, height, *arrays)
        if fault >= 0:
            raise CodecError(f'evt3 word {fault} is of unknown kind {words[fault] >> 12}')
        events = events[:count]
        if count and (np.diff(events.t) < 0).any():
            events = events[np.argsort(events.t, kind='stable')]
        now_us = int(self._state[_HIGH] | self._state[_LOW])
        return DecodedPacket(events, max(now_us, int(events.t[-1])) if count else now_us)


@njit(cache=True, nogil=True)
def _most_events(words: NDArray[np.uint16]) -> int:
    """Return an upper bound of the number of events."""
    count = 0
    for word in words:
        kind = word >> 12
        count += 12 if kind in (_VECTOR_12, _VECTOR_8) else 1 if kind == _EVENT else 0
    return count


@njit(cache=True, nogil=True)
def _decode_words(  # noqa: C901, PLR0912  (one branch per kind of word)
    words: NDArray[np.uint16],
    state: NDArray[np.int64],
    width: int,
    height: int,
    t: NDArray[np.int64],
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    polarity: NDArray[np.bool_],
) -> tuple[int, int]:
    """Fill the event arrays, update the state; return the number of events and the wrong word."""
    n = 0
    for at in range(len(words)):
        kind, value = np.int64(words[at]) >> 12, np.int64(words[at]) & 0xFFF
        if kind == _TIME_HIGH:
            high = (state[_HIGH] & ~np.int64(_ROLL_OVER - 1)) | value << 12
            if state[_HIGH] - high > _BACK:
                high += _ROLL_OVER
            if high != state[_HIGH]:
                # The lower half is not known yet: the time is this, or later.
                state[_LOW] = 0
            state[_HIGH] = high
            state[_KNOWN] |= 1
        elif kind == _TIME_LOW:
            state[_LOW] = value
            if state[_KNOWN] == 1:
                state[_KNOWN] = 3
        elif kind in _IGNORED:
            pass
        elif kind == _ROW:
            state[_Y] = value & 0x7FF
        elif kind == _BASE:
            state[_X], state[_POLARITY] = value & 0x7FF, value >> 11
        elif kind in (_EVENT, _VECTOR_8, _VECTOR_12):
            column, bits, many, on = value & 0x7FF, np.int64(1), 1, value >> 11
            if kind != _EVENT:
                many = 8 if kind == _VECTOR_8 else 12
                column, bits, on = state[_X], value & ((1 << many) - 1), state[_POLARITY]
                state[_X] += many
            if state[_KNOWN] != 3 or state[_Y] >= height:
                continue
            for bit in range(many):
                if bits >> bit & 1 and column + bit < width:
                    t[n] = state[_HIGH] | state[_LOW]
                    x[n] = column + bit
                    y[n] = state[_Y]
                    polarity[n] = on != 0
                    n += 1
        else:
            return n, at
    return n, -1
