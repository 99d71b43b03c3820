# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Impulses in the force of the reference sensor."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from mixtac_alignment.errors import AlignmentError
from mixtac_alignment.force_smoothing import noise_std
from mixtac_alignment.impulses import Impulse, ImpulseSettings, strongest, vertex
from mixtac_alignment.prominent_peaks import prominent_peaks

if TYPE_CHECKING:
    from numpy.typing import NDArray

TOP: Final = 0.9
"""Part of the height above which samples belong to the top of a peak."""
NOISE_FACTOR: Final = 8.0
"""Peaks stand out of the noise by this many standard deviations."""


def find_force_impulses(
    t_s: NDArray[np.float64],
    force_N: NDArray[np.float64],
    settings: ImpulseSettings | None = None,
) -> list[Impulse]:
    """Find sharp force peaks, with times between the samples.

    Args:
        t_s: Increasing sample times [s], relative to the start of the recording (epoch times would
            cost digits), reference clock, ``float64 [N]``.
        force_N: Normal force [N], of either sign, ``float64 [N]``.
        settings: What counts as an impulse.

    Returns:
        Impulses in the order of time; bounces are merged into the strongest.

    Raises:
        AlignmentError: Arrays that are no recording.
    """
    chosen = settings or ImpulseSettings()
    _require_recording(t_s, force_N)
    force = _pressing(force_N)
    period = float(np.median(np.diff(t_s)))
    least = max(chosen.min_force, NOISE_FACTOR * noise_std(force))
    window = 2 * max(3, round(2.0 * chosen.max_width_s / period)) + 1
    peaks = prominent_peaks(force, least, window)
    impulses = [
        _impulse(t_s, force, int(peak), float(height), float(width) * period, period)
        for peak, height, width in zip(*peaks, strict=True)
        if width * period <= chosen.max_width_s
    ]
    return strongest(impulses, chosen.min_spacing_s)


def _impulse(
    t_s: NDArray[np.float64],
    force: NDArray[np.float64],
    peak: int,
    height: float,
    width_s: float,
    period: float,
) -> Impulse:
    first, last = _top(force, peak, force[peak] - (1.0 - TOP) * height)
    time_s, std_s = vertex(t_s[first:last], force[first:last])
    flat_first, flat_last = _top(force, peak, force[peak] - 1e-6 * height, least=0)
    flat_s = (flat_last - flat_first) * period
    return Impulse(
        time_s=time_s,
        std_s=float(np.hypot(std_s, period / np.sqrt(12.0))),
        strength=height / max(width_s, period),
        width_s=width_s,
        saturated=flat_last - flat_first >= 3 and flat_s > 0.3 * width_s,
    )


def _top(force: NDArray[np.float64], peak: int, level: float, least: int = 2) -> tuple[int, int]:
    """Return the range of samples about the peak above a level, at least `least` to each side."""
    first = last = peak
    while first > 0 and (force[first - 1] >= level or peak - first < least):
        first -= 1
    while last < len(force) - 1 and (force[last + 1] >= level or last - peak < least):
        last += 1
    return first, last + 1


def _pressing(force_N: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the force with the sign that makes pressing positive, and rest at zero."""
    relative = force_N - np.median(force_N)
    return relative if relative.max() >= -relative.min() else -relative


def _require_recording(t_s: NDArray[np.float64], force_N: NDArray[np.float64]) -> None:
    if t_s.shape != force_N.shape or t_s.ndim != 1 or len(t_s) < 16:
        raise AlignmentError(
            f'force recording of shapes {t_s.shape} and {force_N.shape}: give two equal 1-d arrays '
            'of at least 16 samples'
        )
    if not (np.isfinite(t_s).all() and np.isfinite(force_N).all()):
        raise AlignmentError('force recording holds NaN or infinity: remove these samples')
    if not np.all(np.diff(t_s) > 0.0):
        raise AlignmentError('force sample times do not increase: sort them and drop repeats')
