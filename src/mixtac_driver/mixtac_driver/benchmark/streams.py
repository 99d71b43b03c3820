# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Streams of known content for measuring the decoder."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

ROWS_PER_STAMP = 10
FRAME_COLUMNS, FRAME_ROWS = 260, 346


def event_stream(
    events_per_row: int, count: int, *, random: bool, seed: int = 1
) -> NDArray[np.uint16]:
    """Return a stream of about `count` events for the default geometry.

    Args:
        events_per_row: Events that share a row address.
        count: Events.
        random: True for a geometric spread of the events per row and of the stamps.
        seed: Of addresses and polarities.
    """
    rng = np.random.default_rng(seed)
    rows = count // events_per_row
    lengths = np.full(rows, events_per_row)
    stamped = np.arange(rows) % ROWS_PER_STAMP == 0
    if random:
        lengths = rng.geometric(1 / events_per_row, rows)
        stamped = rng.random(rows) < 1 / ROWS_PER_STAMP
        stamped[0] = True
    ticks = np.cumsum(stamped)
    wrapped = stamped & (ticks % 0x8000 == 0)
    sizes = lengths + 1 + stamped
    starts = np.cumsum(sizes) - sizes
    total = int(sizes.sum())
    words = rng.integers(0, 260, total) | np.where(rng.random(total) < 0.5, 0x2000, 0x3000)
    words[starts[stamped]] = 0x8000 | (ticks[stamped] & 0x7FFF)
    words[starts[wrapped]] = 0x7001
    words[starts + stamped] = 0x1000 | rng.integers(0, 346, rows)
    return words.astype('<u2')


def frame_stream(frames: int, seed: int = 1) -> NDArray[np.uint16]:
    """Return a stream of full global-shutter frames for the default geometry."""
    rng = np.random.default_rng(seed)
    region = [0x5100, 0x5200, 0x5100, 0x5200, 0x5101, 0x5259, 0x5101, 0x5203]
    head = [8, 0x6000, 0x6000, 0x6000, *region]

    def columns(kind: int, low: int, high: int) -> NDArray[np.int64]:
        block = np.full((FRAME_COLUMNS, FRAME_ROWS + 2), 13)
        block[:, 0] = kind
        block[:, 1:-1] = 0x4000 | rng.integers(low, high, (FRAME_COLUMNS, FRAME_ROWS))
        return block.ravel()

    reset, signal = columns(11, 700, 1000), columns(12, 100, 700)
    frame = np.concatenate((head, reset, [14, 15], signal, [10]))
    return np.tile(frame, frames).astype('<u2')


def repeated(words: NDArray[np.uint16], size: int) -> NDArray[np.uint16]:
    """Return a stream again and again, a wrap of the time before each, up to about a size.

    Args:
        words: The stream.
        size: [B]; at least one whole stream comes back.
    """
    once = np.concatenate((np.array([0x7001], '<u2'), words))
    return np.tile(once, max(round(size / once.nbytes), 1))
