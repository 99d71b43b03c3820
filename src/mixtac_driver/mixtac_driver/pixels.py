# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Pixel masks: dropping events of unwanted pixels, and finding hot pixels.

The camera has eight single-pixel filters. They mask the noisiest pixels, whose events then use no
bandwidth. Events of further pixels are discarded on the host, with one table look-up per event.

A hot pixel fires all the time while its neighbours do not. A pixel counts as hot if it fires often,
and many times as often as the fourth noisiest of the 24 pixels around it: flickering edges and
lights make more than three neighbours fire, even where they are one pixel thin, and up to four hot
pixels may be adjacent.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numba import int64, njit
from numpy.typing import NDArray

from mixtac_core.events.arrays import Events
from mixtac_core.node.files import replacing
from mixtac_driver.camera import CameraBatch
from mixtac_driver.davis346.registers import PIXEL_FILTERS
from mixtac_driver.errors import ConfigurationError

IN_CAMERA = 255
"""Grey value of a pixel that the camera masks, in the image of a mask."""
ON_HOST = 128
"""Grey value of a pixel that the host masks."""
Pixel = tuple[int, int]


class PixelMask:
    """Masked pixels, the noisiest first. One thread at a time calls `keep`.

    Args:
        pixels: (column, row) of each.
        size: Columns and rows of the pixel array; an empty mask fits every array.

    Attributes:
        pixels: All masked pixels.
        size: As given.
        dropped: Events dropped so far.

    Raises:
        ConfigurationError: A pixel is outside the array.
    """

    def __init__(self, pixels: Iterable[Pixel] = (), size: tuple[int, int] = (0, 0)) -> None:
        self.pixels: tuple[Pixel, ...] = tuple(dict.fromkeys(pixels))
        self.size = size
        self.dropped = 0
        width, height = size
        rows, columns = np.mgrid[0:height, 0:width]
        self._places = (rows << 16 | columns).astype(np.int32)
        for column, row in self.pixels:
            if not (0 <= column < width and 0 <= row < height):
                raise ConfigurationError(
                    f'masked pixel ({column}, {row}) is outside the {width} x {height} pixels'
                )
            self._places[row, column] = -1
        self._kept: tuple[NDArray[Any], ...] = ()

    @property
    def in_camera(self) -> tuple[Pixel, ...]:
        """Pixels for the camera's own filters."""
        return self.pixels[:PIXEL_FILTERS]

    def check_size(self, size: tuple[int, int]) -> None:
        """Raise if the mask does not fit a pixel array.

        Args:
            size: Columns and rows of the array.

        Raises:
            ConfigurationError: It has another size.
        """
        if self.pixels and self.size != size:
            raise ConfigurationError(
                f'pixel mask of {self.size[0]} x {self.size[1]} pixels does not fit the camera',
                remedy=f'give a mask of {size[0]} x {size[1]} pixels',
            )

    def keep(self, events: Events) -> Events:
        """Return the events of pixels that are not masked; valid until the next call.

        Args:
            events: Events with any clock, inside the pixel array.
        """
        if not self.pixels or not len(events):
            return events
        if not self._kept or len(self._kept[0]) < len(events):
            self._kept = Events.empty(len(events)).fields
        kept = move_events(events, self._places, self._kept)
        self.dropped += len(events) - len(kept)
        return kept


def load_mask(path: str) -> PixelMask:
    """Return the mask in a PNG file: all pixels that are not black, the brightest first.

    Args:
        path: The file; an empty path is an empty mask.

    Raises:
        ConfigurationError: The file cannot be read or is not a grey image of 8 bits.
    """
    if not path:
        return PixelMask()
    # Slow to import, and rarely needed.
    import cv2

    # Opening a pipe would wait.
    image: Any = cv2.imread(path, cv2.IMREAD_UNCHANGED) if Path(path).is_file() else None
    if image is None or image.ndim != 2 or image.dtype != np.uint8:
        raise ConfigurationError(
            f'pixel mask {path!r} cannot be read',
            remedy='give a grey PNG image with 8 bits in the size of the camera',
        )
    return PixelMask(_brightest_first(image, image > 0), (image.shape[1], image.shape[0]))


def save_mask(mask: PixelMask, path: str) -> None:
    """Write a mask to a PNG file, whole or not at all; makes the folder.

    Raises:
        FileError: The file cannot be written.
    """
    import cv2

    image = np.zeros(mask.size[::-1], np.uint8)
    for index, (column, row) in enumerate(mask.pixels):
        image[row, column] = IN_CAMERA if index < PIXEL_FILTERS else ON_HOST
    _, octets = cv2.imencode('.png', image)
    with replacing(Path(path)) as scratch:
        scratch.write_bytes(octets.tobytes())


def warm_up() -> None:
    """Compile, or load compiled code, before data arrive."""
    one = np.zeros(1, np.uint16)
    events = Events(np.zeros(1, np.int64), one, one, np.zeros(1, np.bool_))
    PixelMask([(0, 0)], (1, 1)).keep(events)


def move_events(
    events: Events, places: NDArray[np.int32], buffers: tuple[NDArray[Any], ...]
) -> Events:
    """Return events at other pixels, in the same order.

    Args:
        events: Events with any clock; those outside the table are dropped.
        places: [rows, columns], new place of each pixel as row * 65536 + column; -1 drops it.
        buffers: `Events.fields` of at least as many events; the result is a view of them.
    """
    n = _move(places, events.fields, buffers)
    return Events(*(each[:n] for each in buffers))


@njit(cache=True, nogil=True)
def _move(places: Any, given: Any, buffers: Any) -> int:  # noqa: ANN401
    t, x, y, polarity = given
    new_t, new_x, new_y, new_polarity = buffers
    rows, columns = places.shape
    n = 0
    for i in range(len(t)):
        place = int64(-1)
        if y[i] < rows and x[i] < columns:
            place = int64(places[y[i], x[i]])
        # Written always and counted only if kept: no branch that noise could mispredict.
        new_t[n] = t[i]
        new_x[n] = place & 0xFFFF
        new_y[n] = place >> 16
        new_polarity[n] = polarity[i]
        n += place >= 0
    return n


def _brightest_first(values: NDArray[Any], chosen: NDArray[np.bool_]) -> list[Pixel]:
    rows, columns = np.nonzero(chosen)
    order = np.argsort(-values[rows, columns].astype(np.int64), kind='stable')
    return list(zip(columns[order].tolist(), rows[order].tolist(), strict=True))


AROUND = np.ones((5, 5), np.bool_)
AROUND[2, 2] = False
"""Neighbours of a pixel: the 24 around it."""
LEAST_RATE_HZ = 10.0
"""Lowest event rate of a hot pixel [1/s]."""
FACTOR = 10.0
"""A hot pixel has at least this many times the events of the pixel it is compared with."""
RANK = -4
"""A pixel is compared with the fourth noisiest of its neighbours."""
FEWEST_EVENTS = 10
"""Fewer than this may be chance where most pixels have none."""
SIGMAS = 5.0
"""Counts scatter by their square root; a pixel is this many of it above its surroundings."""


class PixelCounter:
    """Counts events per pixel over a stretch of camera time.

    Args:
        duration_us: Length of the stretch [us].
        size: Columns and rows of the pixel array.

    Attributes:
        counts: `int64` [rows, columns], events so far.
        done: Set when the stretch is over.
    """

    def __init__(self, duration_us: int, size: tuple[int, int]) -> None:
        self.counts = np.zeros((size[1], size[0]), np.int64)
        self.done = threading.Event()
        self._duration_us = duration_us
        self._end_us: int | None = None

    def add(self, batch: CameraBatch) -> None:
        """Count the events of a batch."""
        events, time_us = batch.decoded.events, batch.time_us
        if self.done.is_set():
            return
        if self._end_us is None:
            # The first events may have passed filters that were just changed.
            self._end_us = time_us + self._duration_us
            return
        shape = self.counts.shape
        flat = events.y.astype(np.int64) * shape[1] + events.x
        self.counts += np.bincount(flat, minlength=self.counts.size).reshape(shape)
        if time_us >= self._end_us:
            self.done.set()


def hot_pixels(counts: NDArray[np.int64], duration_s: float) -> list[Pixel]:
    """Return the hot pixels as (column, row), the noisiest first.

    At the border of the array, the mirrored neighbours count as well: a line of a scene that ends
    there would be hot otherwise, and hot neighbours hide each other.

    Args:
        counts: `int64` [rows, columns], events per pixel.
        duration_s: Time over which they were counted [s].
    """
    # Slow to import, and the driver starts without it.
    from scipy.ndimage import rank_filter

    around = rank_filter(counts.astype(np.float64), RANK, footprint=AROUND, mode='mirror')
    limit = np.maximum(FACTOR * around, around + SIGMAS * np.sqrt(around))
    fewest = max(LEAST_RATE_HZ * duration_s, FEWEST_EVENTS)
    return _brightest_first(counts, (counts > limit) & (counts >= fewest))
