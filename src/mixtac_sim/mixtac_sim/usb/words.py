# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Encoders of the camera's 16-bit stream: events, inertial samples and frames, as the FPGA sends.

A timestamp word precedes a stamped word only when the time changed; a wrap word goes out every
32,768 us whether or not anything happened. Times are int64 microseconds on the camera clock.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple, TypeAlias

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


class TimedWords(NamedTuple):
    """Words of frames and inertial samples.

    Attributes:
        t: Time of each word [us, int64, camera clock], non-decreasing.
        words: ``uint16`` stream words.
    """

    t: NDArray[np.int64]
    words: NDArray[np.uint16]

    @staticmethod
    def at(t_us: int, *words: int) -> TimedWords:
        """Return words that have one time."""
        return TimedWords(np.full(len(words), t_us, np.int64), np.array(words, np.uint16))

    @staticmethod
    def merge(parts: Sequence[TimedWords]) -> TimedWords:
        """Return the words of all parts in order of time; equal times keep the order given."""
        t, words = map(np.concatenate, zip(*parts, strict=True))
        if (t[1:] < t[:-1]).any():
            order = np.argsort(t, kind='stable')
            t, words = t[order], words[order]
        return TimedWords(t, words)

    def split(self, before_us: int) -> tuple[TimedWords, TimedWords]:
        """Cut into the words before a time [us, camera clock] and the rest."""
        cut = int(np.searchsorted(self.t, before_us))
        early = TimedWords(self.t[:cut], self.words[:cut])
        return early, TimedWords(self.t[cut:], self.words[cut:])


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
    word_t: NDArray[np.int64],
    words: NDArray[np.uint16],
    state: NDArray[np.int64],
    out: NDArray[np.uint16],
) -> int:
    n = 0
    k = 0
    for i in range(len(t) + 1):
        while k < len(word_t) and (i == len(t) or word_t[k] < t[i]):
            if words[k] < ROW_WORD:  # the FPGA stamps special words, but no data
                n = _stamp(word_t[k], state, out, n)
            out[n] = words[k]
            n += 1
            k += 1
        if i < len(t):
            n = _row(t[i], row[i], state, out, n)
            out[n] = _COLUMN_WORD | column[i] | (_ON if on[i] else 0)
            n += 1
    return n


class WordEncoder:
    """Turns events, frames and inertial samples into one continuous word stream.

    Row words carry x and column words y, as in the retail chip.

    Attributes:
        state: What the encoder remembers of the words so far; a copy of it may be put back.
    """

    def __init__(self) -> None:
        self.state = np.zeros(4, np.int64)
        self._out = np.empty(1 << 16, np.uint16)
        self.reset()
        # The first call compiles, or loads what was compiled: not while data wait.
        self.encode(Events.empty(), TimedWords.at(0), 0)

    def reset(self) -> None:
        """Restart time at zero; the caller sends the reset word."""
        self.state[:] = (0, 0, -1, -1)

    def encode(self, events: Events, others: TimedWords, until_us: int) -> NDArray[np.uint16]:
        """Encode everything up to a time, wraps included.

        Args:
            events: Sorted by ``t`` [us, camera clock].
            others: Words of frames and inertial samples.
            until_us: Time [us, camera clock] up to which wraps are due.

        Returns:
            Stream words, ``uint16``; a view that the next call overwrites.
        """
        last_us = max(until_us, int(events.t[-1]) if len(events) else 0)
        wraps = max(0, last_us - int(self.state[_BASE])) // _WRAP_US + 2
        needed = 3 * len(events) + 2 * len(others.t) + wraps
        if needed > len(self._out):
            self._out = np.empty(2 * needed, np.uint16)
        count = _encode(*events.fields, *others, self.state, self._out)
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


def imu_words(reading: ImuReading, settings: ImuSettings) -> TimedWords:
    """Lay one sample out at its time: start, info byte, big-endian values, end.

    Args:
        reading: The sample.
        settings: Registers now; at least one group runs.
    """
    values = raw_values(reading, settings)
    data = (_BYTE | byte for byte in struct.pack(f'>{len(values)}h', *values))
    return TimedWords.at(reading.t_us, _START, _INFO | settings.info, *data, _END)


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
# Event words come between the samples of a column on the real bus; pieces of this many samples,
# each at one time, keep that true.
_SAMPLES_PER_PIECE: Final = 58


def _columns(
    samples: NDArray[np.uint16], special: int, start_us: NDArray[np.int64], span: float
) -> TimedWords:
    """Return the words of columns, each cut in pieces that are spread over ``span`` us."""
    count, length = samples.shape
    words = np.empty((count, length + 2), np.uint16)
    words[:, 0] = special
    words[:, 1:-1] = (samples & 0x3FF) | _ADC_WORD
    words[:, -1] = _COLUMN_END
    pieces = 1 + np.arange(length) // _SAMPLES_PER_PIECE * _SAMPLES_PER_PIECE
    begin = np.concatenate(((0,), pieces, (length + 1,)))
    offsets = np.floor(begin / (length + 1) * span).astype(np.int64)
    return TimedWords((start_us[:, None] + offsets).ravel(), words.ravel())


Region: TypeAlias = tuple[int, int, int, int]
"""Start column, start row, end column, end row of a picture; inclusive, user orientation."""


def _header(region: Region, exposure_cycles: int, *, global_shutter: bool) -> list[int]:
    words = [_GLOBAL_START if global_shutter else _ROLLING_START]
    words += [_EXPOSURE_WORD | (exposure_cycles >> shift & 0x3FF) for shift in (0, 10, 20)]
    for value in region:
        words += [_REGION_HIGH | (value >> 8 & 0xFF), _REGION_LOW | (value & 0xFF)]
    return words


def frame_words(
    frame: ApsFrame, region: Region, exposure_cycles: int, *, global_shutter: bool
) -> TimedWords:
    """Lay a frame out as the camera reads it; times are those of the frame.

    Args:
        frame: The samples.
        region: What is read of the picture.
        exposure_cycles: Exposure register [ADC cycles].
        global_shutter: All reset columns before the exposure, all signal columns after it.

    Returns:
        Words in readout order; an empty region gives a frame without columns.
    """
    start, exposed = frame.frame_start_us, frame.exposure_start_us
    closed, end = frame.exposure_end_us, frame.frame_end_us
    left, top, right, bottom = region
    # A column of the readout is a row of the picture.
    part = slice(top, bottom + 1), slice(left, right + 1)
    resets, signals = frame.reset[part], frame.signal[part]
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
    header = _header(region, exposure_cycles, global_shutter=global_shutter)
    return TimedWords.merge(
        [
            TimedWords.at(start, *header),
            _columns(resets, _RESET_COLUMN, reset_t, spans[0]),
            TimedWords.at(exposed, _EXPOSURE_START),
            TimedWords.at(closed, _EXPOSURE_END),
            _columns(signals, _SIGNAL_COLUMN, signal_t, spans[1]),
            TimedWords.at(end, _FRAME_END),
        ]
    )
