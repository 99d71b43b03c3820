# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The plain encoding `libcaer` of `event_camera_msgs/EventPacket`.

Eight bytes per event, little-endian: ``uint32`` data, then ``int32`` time. In the data, bit 0
marks a valid event, bit 1 the polarity, bits 2 to 16 the row, bits 17 to 31 the column. The time
holds the low 31 bits of the camera time [us]; `time_base` [ns] is the rest of the camera time of
the first event, times 1000. Where the low bits roll over inside a packet (every 35.8 minutes),
later events lie 2^31 us later.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mixtac_core.events.arrays import Events
from mixtac_core.events.packets import CodecError, DecodedPacket, EncodedPacket

Times = NDArray[np.int64]
Words = NDArray[np.uint16]
Flags = NDArray[np.bool_]


NAME: Final = 'libcaer'
MAX_COORDINATE: Final = (1 << 15) - 1
MAX_STEP_US: Final = (1 << 30) - 1
"""Longest step between neighbouring events: longer ones would look like a roll-over."""
_ROLL_OVER: Final = 1 << 31
_LOW_MASK: Final = _ROLL_OVER - 1
_UNSORTED: Final = -1
_TOO_LONG: Final = -2
_OUTSIDE: Final = -3
_NEGATIVE: Final = -4


def encode(events: Events, complete_until: int | None = None) -> EncodedPacket:
    """Encode events; see `mixtac_core.events.codec.encode`.

    The encoding has no room for `complete_until`; consumers take the time of the last event.

    Args:
        events: At least one event, camera clock, times not decreasing.
        complete_until: Not used.

    Raises:
        CodecError: Coordinates over 15 bits, times that decrease or leave a gap of 2^30 us.
    """
    del complete_until
    words = np.empty(len(events), np.uint64)
    fault, at = _encode_words(events.t, events.x, events.y, events.polarity, words)
    if fault:
        raise _encode_error(fault, events, at)
    time_base = (int(events.t[0]) & ~_LOW_MASK) * 1000
    return EncodedPacket(NAME, time_base, words.view(np.uint8))


def _encode_error(fault: int, events: Events, at: int) -> CodecError:
    if fault == _OUTSIDE:
        return CodecError(
            f'event {at} lies at ({events.x[at]}, {events.y[at]}); libcaer holds coordinates up to '
            f'{MAX_COORDINATE}'
        )
    before, now = int(events.t[at - 1]), int(events.t[at])
    if fault == _UNSORTED:
        return CodecError(
            f'event {at} is at {now} us, before the one at {before} us: sort events by t'
        )
    return CodecError(
        f'events {at - 1} and {at} are {now - before} us apart; a libcaer packet holds steps up to '
        f'{MAX_STEP_US} us: cut the stream into shorter packets'
    )


def decode(payload: NDArray[np.uint8], start_us: int, *, width: int, height: int) -> DecodedPacket:
    """Decode a packet that is not empty; see `mixtac_core.events.codec.decode`.

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
    words = payload.view(np.uint64)
    events = Events.empty(words.size)
    count, last, fault, at = _decode_words(
        words, start_us, width, height, events.t, events.x, events.y, events.polarity
    )
    if fault == _NEGATIVE:
        raise CodecError(f'libcaer event {at} has a negative time: not libcaer, or damaged')
    if fault:
        raise CodecError(
            f'libcaer event {at} lies outside the sensor of {width} x {height}: give the width and '
            'height of the camera that made the packet'
        )
    return DecodedPacket(events if count == words.size else events[:count], int(last))


@njit(cache=True, nogil=True)
def _encode_words(
    t: Times, x: Words, y: Words, polarity: Flags, words: NDArray[np.uint64]
) -> tuple[int, int]:
    """Fill the words; return (0, 0) or (fault, event)."""
    before = t[0]
    for i in range(len(t)):
        if t[i] < before:
            return _UNSORTED, i
        if t[i] - before > MAX_STEP_US:
            return _TOO_LONG, i
        if x[i] > MAX_COORDINATE or y[i] > MAX_COORDINATE:
            return _OUTSIDE, i
        before = t[i]
        data = (np.int64(x[i]) << 17) | (np.int64(y[i]) << 2) | (np.int64(polarity[i]) << 1) | 1
        words[i] = ((t[i] & _LOW_MASK) << 32) | data
    return 0, 0


@njit(cache=True, nogil=True)
def _decode_words(
    words: NDArray[np.uint64],
    start: int,
    width: int,
    height: int,
    t: Times,
    x: Words,
    y: Words,
    polarity: Flags,
) -> tuple[int, int, int, int]:
    """Fill the event arrays; return (events, last time, fault, word)."""
    n = 0
    # Signed numbers throughout: numba keeps unsigned ones unsigned through differences.
    before = np.int64(words[0] >> np.uint64(32))
    for i in range(len(words)):
        data = np.int64(words[i] & np.uint64(0xFFFFFFFF))
        low = np.int64(words[i] >> np.uint64(32))
        if low > _LOW_MASK:
            return n, 0, _NEGATIVE, i
        if before - low > MAX_STEP_US:
            start += _ROLL_OVER
        before = low
        if data & 1 == 0:
            continue
        row = (data >> 2) & MAX_COORDINATE
        column = data >> 17
        if row >= height or column >= width:
            return n, 0, _OUTSIDE, i
        t[n] = start + low
        x[n] = column
        y[n] = row
        polarity[n] = (data & 2) != 0
        n += 1
    return n, int(start + before), 0, 0
