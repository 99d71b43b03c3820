# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The compressed encoding `libcaer_cmp` of `event_camera_msgs/EventPacket`.

Little-endian 16-bit words: a code in the top 4 bits and a value in the low 12.

==== =========== ====================================== =====================================
code name        value                                  effect
==== =========== ====================================== =====================================
0    TIME_HIGH   bits 12 to 23 of dt [us]               sets the upper half of the time
1    TIME_LOW    bits 0 to 11 of dt [us]                sets the lower half of the time
2    ADDR_X      column (11 bits)                       sets the column
3    ADDR_Y      row (11 bits), polarity (bit 11)       one event
4    VECT_BASE_Y first row (11 bits), polarity (bit 11) sets the base of the vectors that follow
5    VECT_8      8 valid bits                           events at base + bit, then base += 8
==== =========== ====================================== =====================================

dt counts from `time_base` [ns], the camera time of the packet's first event; both halves start
at 0 in every packet. A TIME_LOW always follows a TIME_HIGH, because decoders that stop at a time
limit look at the clock only there. After the last event this encoder may set the time once more:
to decoders that do not know, this is a time word like any other; to ours it says up to which time
the stream is complete.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from mixtac_events import libcaer_cmp_kernels as kernels
from mixtac_events.arrays import Events
from mixtac_events.errors import CodecError
from mixtac_events.packets import DecodedPacket, EncodedPacket

if TYPE_CHECKING:
    from numpy.typing import NDArray

NAME: Final = 'libcaer_cmp'


def encode(events: Events, complete_until: int | None = None) -> EncodedPacket:
    """Encode events; see `mixtac_events.codec.encode`.

    Args:
        events: At least one event, camera clock, times not decreasing.
        complete_until: Camera clock [us], not before the last event, or None.

    Raises:
        CodecError: Coordinates over 11 bits, times that decrease or span more than 24 bits.
    """
    start = int(events.t[0])
    end = int(events.t[-1]) if complete_until is None else complete_until
    words = np.empty(4 * len(events) + 2, np.uint16)
    used, at = kernels.encode_words(events.t, events.x, events.y, events.polarity, end, words)
    if used < 0:
        raise _encode_error(used, events, at, end)
    return EncodedPacket(NAME, start * 1000, words[:used].view(np.uint8).copy())


def _encode_error(fault: int, events: Events, at: int, end: int) -> CodecError:
    if fault == kernels.UNSORTED:
        before = int(events.t[at - 1])
        return CodecError(
            f'event {at} is at {events.t[at]} us, before the one at {before} us: sort events by t'
        )
    if fault == kernels.TOO_LONG:
        last = int(events.t[at]) if at < len(events) else end
        return CodecError(
            f'packet spans {last - int(events.t[0])} us; libcaer_cmp holds '
            f'{kernels.MAX_SPAN_US} us: cut the stream into shorter packets'
        )
    return CodecError(
        f'event {at} lies at ({events.x[at]}, {events.y[at]}); libcaer_cmp holds coordinates up to '
        f'{kernels.MAX_COORDINATE}: use the encoding libcaer for larger sensors'
    )


def decode(payload: NDArray[np.uint8], time_base: int, *, width: int, height: int) -> DecodedPacket:
    """Decode a packet that is not empty; see `mixtac_events.codec.decode`.

    Raises:
        CodecError: Odd length, unknown word, event before a column or base, or outside the sensor.
    """
    if payload.size % 2:
        raise CodecError(
            f'libcaer_cmp payload of {payload.size} bytes: truncated, a word has 2 bytes'
        )
    words = payload.view(np.uint16)
    count, at = kernels.count_events(words)
    if count < 0:
        raise _decode_error(count, words, at, width, height)
    events = Events(
        np.empty(count, np.int64),
        np.empty(count, np.uint16),
        np.empty(count, np.uint16),
        np.empty(count, np.bool_),
    )
    dt, at = kernels.decode_words(
        words, time_base // 1000, width, height, events.t, events.x, events.y, events.polarity
    )
    if dt < 0:
        raise _decode_error(dt, words, at, width, height)
    return DecodedPacket(events, time_base // 1000 + dt)


def _decode_error(
    fault: int, words: NDArray[np.uint16], at: int, width: int, height: int
) -> CodecError:
    where = f'libcaer_cmp word {at} (0x{int(words[at]):04x})'
    if fault == kernels.UNKNOWN_CODE:
        return CodecError(
            f'{where} has unknown code {words[at] >> 12}: not libcaer_cmp, or damaged'
        )
    if fault == kernels.NO_COLUMN:
        return CodecError(f'{where} is an event before any column word: the packet lost its start')
    if fault == kernels.NO_BASE:
        return CodecError(f'{where} is a vector before any base word: the packet lost its start')
    return CodecError(
        f'{where} is an event outside the sensor of {width} x {height}: give the width and height '
        'of the camera that made the packet'
    )
