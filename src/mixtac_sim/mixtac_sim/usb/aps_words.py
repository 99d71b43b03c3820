# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Frames to readout blocks: start, exposure, region, pixel columns, end."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Protocol

import numpy as np

from mixtac_sim.usb.word_encoder import Blocks

if TYPE_CHECKING:
    from numpy.typing import NDArray

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


class Frame(Protocol):
    """One exposure of the sensor as the simulation hands it over (see `mixtac_sim.sensor`).

    Times are integer microseconds of true time; ``reset`` and ``signal`` are 10-bit ADC samples,
    ``uint16 [260, 346]``.
    """

    @property
    def frame_start_us(self) -> int: ...  # noqa: D102
    @property
    def exposure_start_us(self) -> int: ...  # noqa: D102
    @property
    def exposure_end_us(self) -> int: ...  # noqa: D102
    @property
    def frame_end_us(self) -> int: ...  # noqa: D102
    @property
    def reset(self) -> NDArray[np.uint16]: ...  # noqa: D102
    @property
    def signal(self) -> NDArray[np.uint16]: ...  # noqa: D102


@dataclass(frozen=True, slots=True)
class ReadoutSettings:
    """The frame registers that shape a readout.

    Attributes:
        region: Start column, start row, end column, end row; inclusive, user orientation.
        exposure_cycles: Exposure register [ADC cycles].
        global_shutter: All reset columns before the exposure, all signal columns after it.
        orientation: Bit 2 axes inverted, bit 1 columns and bit 0 rows sent in reverse.
    """

    region: tuple[int, int, int, int]
    exposure_cycles: int
    global_shutter: bool
    orientation: int


def _columns(picture: NDArray[np.uint16], settings: ReadoutSettings) -> NDArray[np.uint16]:
    start_column, start_row, end_column, end_row = settings.region
    crop = picture[start_row : end_row + 1, start_column : end_column + 1]
    columns = crop if settings.orientation & 4 else crop.T
    columns = columns[::-1] if settings.orientation & 2 else columns
    return columns[:, ::-1] if settings.orientation & 1 else columns


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


def _header(settings: ReadoutSettings) -> list[int]:
    words = [_GLOBAL_START if settings.global_shutter else _ROLLING_START]
    cycles = settings.exposure_cycles
    words += [_EXPOSURE_WORD | (cycles >> shift & 0x3FF) for shift in (0, 10, 20)]
    for value in settings.region:
        words += [_REGION_HIGH | (value >> 8 & 0xFF), _REGION_LOW | (value & 0xFF)]
    return words


def _single(t: int, *words: int) -> Blocks:
    return Blocks.from_lists([t], [True], [list(words)])


def frame_blocks(frame: Frame, times_us: NDArray[np.int64], settings: ReadoutSettings) -> Blocks:
    """Lay a frame out as the camera reads it.

    Args:
        frame: The samples.
        times_us: Frame start, exposure start, exposure end, frame end [us, camera clock].
        settings: Registers at the start of the frame.

    Returns:
        Blocks in readout order; an empty region gives a frame without columns.
    """
    start, exposed, closed, end = (int(t) for t in times_us)
    resets = _column_words(_columns(frame.reset, settings), _RESET_COLUMN)
    signals = _column_words(_columns(frame.signal, settings), _SIGNAL_COLUMN)
    count = len(resets)
    if settings.global_shutter:
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
            _single(start, *_header(settings)),
            _column_blocks(resets, reset_t, spans[0]),
            _single(exposed, _EXPOSURE_START),
            _single(closed, _EXPOSURE_END),
            _column_blocks(signals, signal_t, spans[1]),
            _single(end, _FRAME_END),
        ]
    )
