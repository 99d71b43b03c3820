# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Impulses in the event rate: a burst, a trough, a burst."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.signal import find_peaks, peak_widths

from mixtac_alignment.impulses import Impulse, ImpulseSettings, strongest, vertex

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_alignment.rate_history import EventCounts

SMOOTHING_S: Final = 0.001
"""Standard deviation of the smoothing: bursts last 2 to 20 ms, single bins scatter."""
BOTTOM: Final = 0.5
"""Part of the depth below which bins belong to the bottom of a trough."""
QUEUE_STD_S: Final = 0.001
"""Extra uncertainty where the readout was saturated: late events fill the trough's start."""


def find_event_impulses(
    counts: EventCounts, settings: ImpulseSettings | None = None
) -> list[Impulse]:
    """Find troughs between two bursts, with times finer than a bin.

    Args:
        counts: Event counts in bins of at most 1 ms, camera clock.
        settings: What counts as an impulse.

    Returns:
        Impulses in the order of time, relative to the start of the counts; none that touch a time
        for which packets were lost, where a trough may only be missing data.
    """
    chosen = settings or ImpulseSettings()
    width_s = counts.width_us * 1e-6
    per_second = counts.counts.astype(np.float64) / width_s
    rate: NDArray[np.float64] = np.asarray(
        gaussian_filter1d(per_second, SMOOTHING_S / width_s, mode='nearest')
    )
    window = 2 * max(3, round(2.0 * chosen.max_width_s / width_s)) + 1
    troughs, found = find_peaks(-rate, prominence=chosen.min_burst_rate, wlen=window)
    edges = (found['prominences'], found['left_bases'], found['right_bases'])
    widths = peak_widths(-rate, troughs, 0.5, edges)[0] * width_s
    impulses = [
        _impulse(rate, int(trough), float(depth), float(width), width_s, chosen)
        for trough, depth, width in zip(troughs, found['prominences'], widths, strict=True)
        if width <= chosen.max_width_s
        and rate[trough] <= chosen.max_trough_ratio * (rate[trough] + depth)
        and not counts.lost_near(trough, window)
    ]
    return strongest(impulses, chosen.min_spacing_s)


def _impulse(
    rate: NDArray[np.float64],
    trough: int,
    depth: float,
    width: float,
    width_s: float,
    settings: ImpulseSettings,
) -> Impulse:
    first, last = _bottom(rate, trough, rate[trough] + BOTTOM * depth)
    centres_s = np.asarray((np.arange(first, last) + 0.5) * width_s, np.float64)
    time_s, std_s = vertex(centres_s, rate[first:last])
    # Smoothing correlates neighbouring bins: fewer of them are independent.
    shared = np.sqrt(2.0 * np.sqrt(np.pi) * SMOOTHING_S / width_s)
    queue_s = QUEUE_STD_S if rate[trough] + depth > settings.readout_rate else 0.0
    return Impulse(
        time_s=time_s,
        std_s=float(np.sqrt((shared * std_s) ** 2 + width_s**2 / 12.0 + queue_s**2)),
        strength=depth,
        width_s=width,
    )


def _bottom(rate: NDArray[np.float64], trough: int, level: float) -> tuple[int, int]:
    """Return the range of bins about the trough below a level, at least two to each side."""
    first = last = trough
    while first > 0 and (rate[first - 1] <= level or trough - first < 2):
        first -= 1
    while last < len(rate) - 1 and (rate[last + 1] <= level or last - trough < 2):
        last += 1
    return first, last + 1
