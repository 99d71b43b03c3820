# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Undistortion of events by a table that is made once."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from mixtac_events.arrays import Events

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_driver.calibration.camera_calibration import CameraCalibration

_NOWHERE = -1
_ROW = 65536
_OUTSIDE_PX = -1e6


class EventUndistortion:
    """Events at the nearest pixel of the rectified camera.

    Rectification spreads the middle of a wide-angle image and crops its rim: some rectified pixels
    never have an event, and raw pixels whose rectified place lies outside the image lose theirs.

    Args:
        calibration: The camera; its R and P say what to rectify to.

    Attributes:
        table: `int32` [height, width], rectified place of each raw pixel as row * 65536 + column,
            -1 where it is outside the image.
    """

    def __init__(self, calibration: CameraCalibration) -> None:
        width, height = self._size = calibration.size
        rows, columns = np.mgrid[0:height, 0:width].astype(np.float64)
        ideal = calibration.undistort(np.stack([columns.ravel(), rows.ravel()], axis=1))
        near = np.floor(np.nan_to_num(ideal, nan=_OUTSIDE_PX) + 0.5).clip(_OUTSIDE_PX, -_OUTSIDE_PX)
        inside = ((near >= 0.0) & (near < (width, height))).all(axis=1)
        places = (near[:, 1] * _ROW + near[:, 0]).astype(np.int64).astype(np.int32)
        self.table = np.where(inside, places, np.int32(_NOWHERE)).reshape(height, width)
        self.undistort(Events.empty())  # compile before the first events are waiting

    @property
    def kept(self) -> float:
        """Return the share of raw pixels that have a place in the rectified image."""
        return float((self.table >= 0).mean())

    def undistort(self, events: Events) -> Events:
        """Return the events that fall inside the rectified image, in the same order.

        Args:
            events: Raw events; the clock of their times does not matter.

        Returns:
            Events in new arrays; as many are missing as lie outside.
        """
        n = len(events)
        t, x, y, polarity = (
            np.empty(n, np.int64),
            np.empty(n, np.uint16),
            np.empty(n, np.uint16),
            np.empty(n, np.bool_),
        )
        kept = _compact(
            self.table, events.t, events.x, events.y, events.polarity, t, x, y, polarity
        )
        return Events(t[:kept], x[:kept], y[:kept], polarity[:kept])

    def locate(
        self, x: NDArray[np.uint16], y: NDArray[np.uint16]
    ) -> tuple[NDArray[np.uint16], NDArray[np.uint16], NDArray[np.bool_]]:
        """Return rectified columns, rows and validity of raw pixels; invalid ones are (0, 0).

        Args:
            x: Columns [n].
            y: Rows [n].
        """
        new_x, new_y = np.empty_like(x), np.empty_like(y)
        valid = np.empty(len(x), np.bool_)
        _locate(self.table, x, y, new_x, new_y, valid)
        return new_x, new_y, valid


@njit(cache=True, nogil=True)
def _compact(
    table: NDArray[np.int32],
    t: NDArray[np.int64],
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    polarity: NDArray[np.bool_],
    new_t: NDArray[np.int64],
    new_x: NDArray[np.uint16],
    new_y: NDArray[np.uint16],
    new_polarity: NDArray[np.bool_],
) -> int:
    """Write the events that have a place; return how many."""
    height, width = table.shape
    kept = 0
    for i in range(len(t)):
        if x[i] >= width or y[i] >= height:
            continue
        place = table[y[i], x[i]]
        if place < 0:
            continue
        new_t[kept] = t[i]
        new_x[kept] = place & 0xFFFF
        new_y[kept] = place >> 16
        new_polarity[kept] = polarity[i]
        kept += 1
    return kept


@njit(cache=True, nogil=True)
def _locate(
    table: NDArray[np.int32],
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    new_x: NDArray[np.uint16],
    new_y: NDArray[np.uint16],
    valid: NDArray[np.bool_],
) -> None:
    """Look up each pixel."""
    height, width = table.shape
    for i in range(len(x)):
        place = -1
        if x[i] < width and y[i] < height:
            place = table[y[i], x[i]]
        valid[i] = place >= 0
        new_x[i] = place & 0xFFFF if place >= 0 else 0
        new_y[i] = place >> 16 if place >= 0 else 0
