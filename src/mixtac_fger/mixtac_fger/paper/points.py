# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Event packets as the point network reads them."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_events.arrays import Events
    from mixtac_fger.paper.config import PaperConfig


def packet_points(
    config: PaperConfig, events: Events, ends: NDArray[np.int64]
) -> tuple[NDArray[np.float16], NDArray[np.int64]]:
    """Return the normalised events of consecutive packets.

    A packet of more than `PaperConfig.events_per_packet` events is thinned out evenly in time
    order.

    Args:
        config: Shapes.
        events: Sorted events, camera clock [us].
        ends: End of each packet [us], `window_us` apart, int64 [T].

    Returns:
        Points float16 [E, 4]: x and y from -1 to 1 across the sensor, time from 0 to 1 within the
        packet, polarity -1 or 1; and where each packet begins among them, int64 [T + 1].
    """
    cuts = np.searchsorted(events.t, [ends[0] - config.window_us, *ends])
    counts = np.diff(cuts)
    kept = np.minimum(counts, config.events_per_packet)
    starts = np.concatenate([[0], np.cumsum(kept)]).astype(np.int64)
    packet = np.repeat(np.arange(len(ends)), kept)
    rank = np.arange(starts[-1]) - starts[packet]
    index = cuts[packet] + rank * counts[packet] // np.maximum(kept[packet], 1)
    points = np.empty((len(index), 4), np.float16)
    points[:, 0] = 2.0 * events.x[index] / (config.width - 1) - 1.0
    points[:, 1] = 2.0 * events.y[index] / (config.height - 1) - 1.0
    points[:, 2] = (events.t[index] - (ends[packet] - config.window_us)) / config.window_us
    points[:, 3] = np.where(events.polarity[index], 1.0, -1.0)
    return points, starts


def event_counts(
    config: PaperConfig, events: Events, borders: NDArray[np.int64]
) -> NDArray[np.uint8]:
    """Return the events between consecutive times as pictures.

    Args:
        config: Shapes.
        events: Sorted events, camera clock [us].
        borders: Times [us], increasing, int64 [N + 1].

    Returns:
        Number of ON and of OFF events per pixel of `PaperConfig.frame_shape`, at most 255, uint8
        [N, 2, rows, columns].
    """
    rows, columns = config.frame_shape
    out = np.zeros((len(borders) - 1, 2, rows, columns), np.uint8)
    cuts = np.searchsorted(events.t, borders)
    for index, (start, stop) in enumerate(pairwise(cuts)):
        y = events.y[start:stop].astype(np.int64) // config.scale
        x = events.x[start:stop].astype(np.int64) // config.scale
        inside = (y < rows) & (x < columns)
        channel = np.where(events.polarity[start:stop], 0, 1)
        cell = ((channel * rows + y) * columns + x)[inside]
        counts = np.bincount(cell, minlength=2 * rows * columns)
        out[index] = np.minimum(counts, 255).reshape(2, rows, columns)
    return out
