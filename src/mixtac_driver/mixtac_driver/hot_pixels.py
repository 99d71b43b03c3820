# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Finding pixels that fire without cause.

A hot pixel fires all the time and its neighbours do not. So a pixel counts as hot if it fires
often, and many times as often as the fourth noisiest of the 24 pixels around it: edges and lights
that flicker make more than three neighbours fire, even where they are one pixel thin, and up to
four hot pixels may sit together.
"""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

import numpy as np

from mixtac_driver.pixel_mask import HEIGHT, WIDTH, Pixel

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_events.arrays import Events

AROUND = np.ones((5, 5), np.bool_)
AROUND[2, 2] = False
RANK = -4
FEWEST_EVENTS = 10
"""Fewer than this may be chance where most pixels have none."""
SIGMAS = 5.0
"""Counts scatter by their square root; a pixel is this many of it above its surroundings."""


class PixelCounter:
    """Counts events per pixel over a stretch of camera time.

    Args:
        duration_us: Length of the stretch [us].

    Attributes:
        counts: `int64` [260, 346], events so far.
        done: Set when the stretch is over.
    """

    def __init__(self, duration_us: int) -> None:
        self.counts = np.zeros((HEIGHT, WIDTH), np.int64)
        self.done = threading.Event()
        self._duration_us = duration_us
        self._end_us: int | None = None

    def add(self, events: Events, time_us: int) -> None:
        """Count events.

        Args:
            events: Events on the camera clock [us].
            time_us: Time that the stream has reached [us, camera clock].
        """
        if self.done.is_set():
            return
        if self._end_us is None:
            # Those before may have passed filters that have just been changed.
            self._end_us = time_us + self._duration_us
            return
        flat = events.y.astype(np.int64) * WIDTH + events.x
        self.counts += np.bincount(flat, minlength=WIDTH * HEIGHT).reshape(HEIGHT, WIDTH)
        if time_us >= self._end_us:
            self.done.set()


def hot_pixels(
    counts: NDArray[np.int64], duration_s: float, minimum_rate_hz: float, factor: float
) -> list[Pixel]:
    """Return the hot pixels as (column, row), the noisiest first.

    Args:
        counts: `int64` [rows, columns], events per pixel.
        duration_s: Time over which they were counted [s].
        minimum_rate_hz: Pixels with fewer events per second are not hot [1/s].
        factor: Pixels with fewer events than so many times the fourth noisiest around them are
            not hot.
    """
    # Slow to import, and the driver starts without it.
    from scipy.ndimage import rank_filter

    around = rank_filter(counts.astype(np.float64), RANK, footprint=AROUND, mode='mirror')
    limit = np.maximum(factor * around, around + SIGMAS * np.sqrt(around))
    fewest = max(minimum_rate_hz * duration_s, FEWEST_EVENTS)
    rows, columns = np.nonzero((counts > limit) & (counts >= fewest))
    order = np.argsort(-counts[rows, columns], kind='stable')
    return list(zip(columns[order].tolist(), rows[order].tolist(), strict=True))
