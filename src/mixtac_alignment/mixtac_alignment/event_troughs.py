# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Impulses in the event rate: a burst, a trough, a burst."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from mixtac_alignment.gaussian_smoothing import gaussian_smooth
from mixtac_alignment.impulses import Impulse, ImpulseSettings, strongest
from mixtac_alignment.prominent_peaks import prominent_peaks
from mixtac_alignment.stillness import stillness

if TYPE_CHECKING:
    from mixtac_alignment.rate_history import EventCounts

SMOOTHING_S: Final = 0.001
"""Standard deviation of the smoothing: bursts last 2 to 20 ms, single bins scatter."""
MODEL_STD_S: Final = 4e-4
"""How far taps of other shapes move the end of the flank, found with threshold pixels and on
virtual sensors; what moves all alike, the latency of the pixels, stays in the offset of a fit."""
LARGEST_STD_S: Final = 0.0015
"""A moment of stillness that is less certain is none: between bounces of a dropped load, say."""
QUEUE_STD_S: Final = 0.001
"""Extra uncertainty where the readout was saturated: late events fill the trough's start."""


def find_event_impulses(
    counts: EventCounts, settings: ImpulseSettings | None = None
) -> list[Impulse]:
    """Find troughs between two bursts, and the moment of stillness to a part of a bin.

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
    smooth = gaussian_smooth(per_second, SMOOTHING_S / width_s)
    rest = float(np.median(smooth))
    window = 2 * max(3, round(2.0 * chosen.max_width_s / width_s)) + 1
    troughs = prominent_peaks(-smooth, chosen.min_burst_rate, window)
    impulses = [
        _impulse(
            stillness(per_second, smooth, int(trough), float(depth), min(rest, smooth[trough])),
            float(smooth[trough] + depth) > chosen.readout_rate,
            float(depth),
            float(width) * width_s,
            width_s,
        )
        for trough, depth, width in zip(*troughs, strict=True)
        if width * width_s <= chosen.max_width_s
        and smooth[trough] <= chosen.max_trough_ratio * (smooth[trough] + depth)
        and not counts.lost_near(trough, window)
    ]
    certain = [impulse for impulse in impulses if impulse.std_s <= LARGEST_STD_S]
    return strongest(certain, chosen.min_spacing_s)


def _impulse(
    at: tuple[float, float], queued: bool, depth: float, width: float, width_s: float
) -> Impulse:
    """Return the impulse at a position in bins, with its uncertainty in seconds."""
    position, std = at
    variance = (std * width_s) ** 2 + MODEL_STD_S**2 + (QUEUE_STD_S**2 if queued else 0.0)
    return Impulse(
        time_s=position * width_s,
        std_s=float(np.sqrt(variance)),
        strength=depth,
        width_s=width,
    )
