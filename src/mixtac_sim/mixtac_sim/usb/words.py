# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Encoders of the camera's 16-bit stream: events, inertial samples and frames, as the FPGA sends.

A timestamp word precedes a stamped word only when the time changed; a wrap word goes out every
32,768 us whether or not anything happened. Times are int64 microseconds on the camera clock.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mixtac_core.events.arrays import Events
from mixtac_sim.pixels.aps import ApsFrame

TIMESTAMP_RESET_WORD: Final = 0x0001
_WRAP_US: Final = 0x8000
_WRAP_WORD: Final = 0x7001
_STAMP_WORD: Final = 0x8000
ROW_WORD: Final = 0x1000
_COLUMN_WORD: Final = 0x2000
_ON: Final = 0x1000
# Places in the state of the encoder.
_BASE: Final = 0
_LAST: Final = 1
_ROW: Final = 2
_ROW_TIME: Final = 3


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """Readout words that belong together, cut where other words may come between.

    Attributes:
        t: Time of each block [us, int64, camera clock], non-decreasing.
        stamped: Whether the first word of the block is one that the FPGA stamps.
        end: One past each block's last word in ``words``.
        words: ``uint16`` stream words of all blocks.
    """

    t: NDArray[np.int64]
    stamped: NDArray[np.bool_]
    end: NDArray[np.int64]
    words: NDArray[np.uint16]

    @classmethod
    def empty(cls) -> Blocks:
        """Return no blocks."""
        return cls.from_lists([], [], [])

    @classmethod
    def from_lists(cls, times: list[int], stamped: list[bool], words: list[list[int]]) -> Blocks:
        """Build blocks from one entry per block."""
        flat = [word for block in words for word in block]
        ends = np.cumsum([len(block) for block in words], dtype=np.int64)
        return cls(
            np.array(times, np.int64), np.array(stamped, np.bool_), ends, np.array(flat, np.uint16)
        )

    @classmethod
    def merge(cls, parts: list[Blocks]) -> Blocks:
        """Return the blocks of all parts in order of time; equal times keep the order given."""
        parts = [part for part in parts if len(part.t)]
        if not parts:
            return cls.empty()
        offsets = np.cumsum([0] + [len(part.words) for part in parts])
        t = np.concatenate([part.t for part in parts])
        end = np.concatenate([part.end + at for part, at in zip(parts, offsets, strict=False)])
        order = np.argsort(t, kind='stable')
        words = np.concatenate([part.words for part in parts])
        stamped = np.concatenate([part.stamped for part in parts])
        if np.array_equal(order, np.arange(len(t))):
            return cls(t, stamped, end, words)
        return cls(t[order], stamped[order], *_reordered(words, end, order))

    def split(self, before_us: int) -> tuple[Blocks, Blocks]:
        """Cut into the blocks before a time [us, camera clock] and the rest."""
        cut = int(np.searchsorted(self.t, before_us))
        word = int(self.end[cut - 1]) if cut else 0
        early = Blocks(self.t[:cut], self.stamped[:cut], self.end[:cut], self.words[:word])
        late = Blocks(self.t[cut:], self.stamped[cut:], self.end[cut:] - word, self.words[word:])
        return early, late


@njit(cache=True, nogil=True)
def _reordered(
    words: NDArray[np.uint16], end: NDArray[np.int64], order: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.uint16]]:
    out = np.empty_like(words)
    ends = np.empty_like(end)
    n = 0
    for k in range(len(order)):
        block = order[k]
        start = end[block - 1] if block > 0 else 0
        for i in range(start, end[block]):
            out[n] = words[i]
            n += 1
        ends[k] = n
    return ends, out


@njit(cache=True, nogil=True)
def _wrap(t: int, state: NDArray[np.int64], out: NDArray[np.uint16], n: int) -> int:
    while t - state[_BASE] >= _WRAP_US:
        state[_BASE] += _WRAP_US
        state[_LAST] = state[_BASE]
        out[n] = _WRAP_WORD
        n += 1
    return n


@njit(cache=True, nogil=True)
def _stamp(t: int, state: NDArray[np.int64], out: NDArray[np.uint16], n: int) -> int:
    n = _wrap(t, state, out, n)
    # The FPGA's time never runs backwards: a late word takes the time of the one before it.
    if t > state[_LAST]:
        state[_LAST] = t
        out[n] = _STAMP_WORD | (t - state[_BASE])
        n += 1
    return n


@njit(cache=True, nogil=True)
def _row(t: int, row: int, state: NDArray[np.int64], out: NDArray[np.uint16], n: int) -> int:
    # Several events of one row at one time share the row word.
    if row != state[_ROW] or max(t, state[_LAST]) != state[_ROW_TIME]:
        n = _stamp(t, state, out, n)
        state[_ROW] = row
        state[_ROW_TIME] = state[_LAST]
        out[n] = ROW_WORD | row
        n += 1
    return n


@njit(cache=True, nogil=True)
def _encode(
    t: NDArray[np.int64],
    row: NDArray[np.uint16],
    column: NDArray[np.uint16],
    on: NDArray[np.bool_],
    block_t: NDArray[np.int64],
    stamped: NDArray[np.bool_],
    end: NDArray[np.int64],
    words: NDArray[np.uint16],
    state: NDArray[np.int64],
    out: NDArray[np.uint16],
) -> int:
    n = 0
    block = 0
    start = 0
    for i in range(len(t) + 1):
        while block < len(block_t) and (i == len(t) or block_t[block] < t[i]):
            if stamped[block]:
                n = _stamp(block_t[block], state, out, n)
            for k in range(start, end[block]):
                out[n] = words[k]
                n += 1
            start = end[block]
            block += 1
        if i < len(t):
            n = _row(t[i], row[i], state, out, n)
            out[n] = _COLUMN_WORD | column[i] | (_ON if on[i] else 0)
            n += 1
    return n


class WordEncoder:
    """Turns events and readout blocks into one continuous word stream.

    Row words carry x and column words y, as in the retail chip.

    Attributes:
        state: What the encoder remembers of the words so far; a copy of it may be put back.
    """

    def __init__(self) -> None:
        self.state = np.zeros(4, np.int64)
        self._out = np.empty(1 << 16, np.uint16)
        self.reset()
        # The first calls compile, or load what was compiled: not while data wait.
        self.encode(Events.empty(), Blocks.empty(), 0)
        pair = Blocks.from_lists([0, 0], [True, True], [[0], [0]])
        _reordered(pair.words, pair.end, np.zeros(2, np.int64))

    def reset(self) -> None:
        """Restart time at zero; the caller sends the reset word."""
        self.state[:] = (0, 0, -1, -1)

    def encode(self, events: Events, blocks: Blocks, until_us: int) -> NDArray[np.uint16]:
        """Encode everything up to a time, wraps included.

        Args:
            events: Sorted by ``t`` [us, camera clock].
            blocks: Readout blocks sorted by time.
            until_us: Time [us, camera clock] up to which wraps are due.

        Returns:
            Stream words, ``uint16``; a view that the next call overwrites.
        """
        last_us = max(until_us, int(events.t[-1]) if len(events) else 0)
        wraps = max(0, last_us - int(self.state[_BASE])) // _WRAP_US + 2
        needed = 3 * len(events) + len(blocks.t) + len(blocks.words) + wraps
        if needed > len(self._out):
            self._out = np.empty(2 * needed, np.uint16)
        count = _encode(
            *(events.t, events.x, events.y, events.polarity),
            *(blocks.t, blocks.stamped, blocks.end, blocks.words),
            *(self.state, self._out),
        )
        return self._out[: _wrap(until_us, self.state, self._out, count)]


_START: Final = 5
_END: Final = 7
_BYTE: Final = 0x5000
_INFO: Final = 0x5300


@dataclass(frozen=True, slots=True)
class ImuReading:
    """One measurement of the inertial sensor.

    Attributes:
        t_us: True time [us].
        acceleration_g: Specific force along x, y, z [g].
        rate_dps: Turn rate about x, y, z [deg/s].
        temperature_c: Die temperature [deg C].
    """

    t_us: int
    acceleration_g: tuple[float, float, float]
    rate_dps: tuple[float, float, float]
    temperature_c: float


@dataclass(frozen=True, slots=True)
class ImuSettings:
    """The inertial registers that shape a sample; the defaults are those of drivers.

    Attributes:
        accel: Send acceleration.
        gyro: Send turn rates.
        temperature: Send the temperature.
        accel_scale: 0 to 3 for 2, 4, 8, 16 g.
        gyro_scale: 0 to 3 for 250, 500, 1000, 2000 deg/s.
    """

    accel: bool = True
    gyro: bool = True
    temperature: bool = True
    accel_scale: int = 1
    gyro_scale: int = 1

    @property
    def running(self) -> bool:
        """Whether any group is sent."""
        return self.accel or self.gyro or self.temperature

    @property
    def info(self) -> int:
        """The info byte of a sample: which groups are present, and their scales."""
        present = self.accel << 7 | self.gyro << 6 | self.temperature << 5
        return present | self.accel_scale << 2 | self.gyro_scale


def _raw(value: float) -> int:
    return max(-32768, min(32767, round(value)))


def raw_values(reading: ImuReading, settings: ImuSettings) -> list[int]:
    """Return the signed 16-bit values of the groups that run, in the order of the wire.

    Values beyond the full scale saturate. The temperature is 333.87 per kelvin above 21 deg C, as
    in an MPU-9250.
    """
    values: list[int] = []
    if settings.accel:
        per_g = 65536 / (4 << settings.accel_scale)
        values += [_raw(value * per_g) for value in reading.acceleration_g]
    if settings.temperature:
        values.append(_raw((reading.temperature_c - 21.0) * 333.87))
    if settings.gyro:
        per_dps = 65536 / (500 << settings.gyro_scale)
        values += [_raw(value * per_dps) for value in reading.rate_dps]
    return values


def imu_blocks(reading: ImuReading, settings: ImuSettings) -> Blocks:
    """Lay one sample out at its time: start, info byte, big-endian values, end.

    Args:
        reading: The sample.
        settings: Registers now; at least one group runs.
    """
    values = raw_values(reading, settings)
    data = struct.pack(f'>{len(values)}h', *values)
    words = [_START, _INFO | settings.info, *(_BYTE | byte for byte in data)]
    return Blocks.from_lists([reading.t_us] * 2, [True, True], [words, [_END]])


_GLOBAL_START: Final = 8
_ROLLING_START: Final = 9
_FRAME_END: Final = 10
_RESET_COLUMN: Final = 11
_SIGNAL_COLUMN: Final = 12
_COLUMN_END: Final = 13
_EXPOSURE_START: Final = 14
_EXPOSURE_END: Final = 15
_ADC_WORD: Final = 0x4000
_EXPOSURE_WORD: Final = 0x6000
_REGION_HIGH: Final = 0x5100
_REGION_LOW: Final = 0x5200
# Event words come between the samples of a column on the real bus; pieces of this many samples
# keep that true without a block per sample.
_SAMPLES_PER_BLOCK: Final = 58


def _column_words(columns: NDArray[np.uint16], special: int) -> NDArray[np.uint16]:
    words = np.empty((columns.shape[0], columns.shape[1] + 2), np.uint16)
    words[:, 0] = special
    words[:, 1:-1] = (columns & 0x3FF) | _ADC_WORD
    words[:, -1] = _COLUMN_END
    return words


def _column_blocks(words: NDArray[np.uint16], start_us: NDArray[np.int64], span: float) -> Blocks:
    """Cut the words of each column in pieces and spread them over ``span`` us."""
    count, length = words.shape
    inner = np.arange(1, length - 1, _SAMPLES_PER_BLOCK)
    cuts = np.concatenate(((0,), inner, (length - 1,)))
    offsets = np.floor(cuts / (length - 1) * span).astype(np.int64)
    ends = np.concatenate((cuts[1:], (length,)))
    stamped = np.zeros(len(cuts), np.bool_)
    stamped[[0, -1]] = True
    return Blocks(
        (start_us[:, None] + offsets).ravel(),
        np.tile(stamped, count),
        (np.arange(count)[:, None] * length + ends).ravel().astype(np.int64),
        words.ravel(),
    )


Region: TypeAlias = tuple[int, int, int, int]
"""Start column, start row, end column, end row of a picture; inclusive, user orientation."""


def _header(region: Region, exposure_cycles: int, *, global_shutter: bool) -> list[int]:
    words = [_GLOBAL_START if global_shutter else _ROLLING_START]
    words += [_EXPOSURE_WORD | (exposure_cycles >> shift & 0x3FF) for shift in (0, 10, 20)]
    for value in region:
        words += [_REGION_HIGH | (value >> 8 & 0xFF), _REGION_LOW | (value & 0xFF)]
    return words


def _single(t: int, *words: int) -> Blocks:
    return Blocks.from_lists([t], [True], [list(words)])


def frame_blocks(
    frame: ApsFrame, region: Region, exposure_cycles: int, *, global_shutter: bool
) -> Blocks:
    """Lay a frame out as the camera reads it; times are those of the frame.

    Args:
        frame: The samples.
        region: What is read of the picture.
        exposure_cycles: Exposure register [ADC cycles].
        global_shutter: All reset columns before the exposure, all signal columns after it.

    Returns:
        Blocks in readout order; an empty region gives a frame without columns.
    """
    start, exposed = frame.frame_start_us, frame.exposure_start_us
    closed, end = frame.exposure_end_us, frame.frame_end_us
    left, top, right, bottom = region
    # A column of the readout is a row of the picture.
    part = slice(top, bottom + 1), slice(left, right + 1)
    resets = _column_words(frame.reset[part], _RESET_COLUMN)
    signals = _column_words(frame.signal[part], _SIGNAL_COLUMN)
    count = len(resets)
    if global_shutter:
        before, after = (exposed - start) / max(count, 1), (end - closed) / max(count, 1)
        reset_at, signal_at, spans = start, closed, (before, after)
    else:
        # Reset and signal columns take turns, half a step each, and never overlap.
        step = max(2, int((end - closed) / max(count, 1)))
        lag = -(-(closed - start) // step) * step
        reset_at, signal_at = start, start + lag + step // 2
        before = after = float(step)
        spans = (step / 2 - 0.5, step / 2 - 0.5)
        exposed, closed = start + step // 2, max(signal_at - 1, start + step // 2)
        end = signal_at + count * step
    index = np.arange(count)
    reset_t = reset_at + np.floor(index * before).astype(np.int64)
    signal_t = signal_at + np.floor(index * after).astype(np.int64)
    return Blocks.merge(
        [
            _single(start, *_header(region, exposure_cycles, global_shutter=global_shutter)),
            _column_blocks(resets, reset_t, spans[0]),
            _single(exposed, _EXPOSURE_START),
            _single(closed, _EXPOSURE_END),
            _column_blocks(signals, signal_t, spans[1]),
            _single(end, _FRAME_END),
        ]
    )
