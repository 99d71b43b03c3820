# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The moment of stillness at the largest deformation, from the flank of the loading burst.

The middle of the trough is late. A pixel that has fired on the way in must come back by two
thresholds before it fires on the way out, so that the second burst starts late, by milliseconds for
gentle or slow taps; and the way out is often slower than the way in. The first burst has neither
fault: while the motion keeps its direction the rate is proportional to its speed, which falls
linearly to zero at the largest deformation. The anchor is therefore where the falling flank of the
first burst, extended, meets the rate at rest.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

FLANK: Final = (0.12, 0.4)
"""Parts of the burst's height between which its flank is straight: below, the smoothing rounds it;
above, the speed of most taps is curved."""
FEWEST_BINS: Final = 4
LARGEST_STD_BINS: Final = 2.0
"""A line through bins that is less certain than this is none."""
LEVELS: Final = np.arange(0.7, 0.15, -0.1)
"""Parts of the burst's height at which the flank is timed where its bins form no line: many pixels
with nearly the same threshold make plateaus."""


def stillness(
    rate: NDArray[np.float64],
    smooth: NDArray[np.float64],
    trough: int,
    depth: float,
    rest: float,
) -> tuple[float, float]:
    """Return when the flank before a trough runs out, and its standard deviation, in bins.

    Args:
        rate: Event rate per bin.
        smooth: The same, smoothed.
        trough: Bin of the trough.
        depth: Height of the weaker burst over the trough.
        rest: Rate at rest.

    Returns:
        Position on the axis where bin k covers ``[k, k + 1)``; between the burst and the end of the
        trough.
    """
    burst = _burst_before(smooth, trough, smooth[trough] + 0.9 * depth)
    first, last = _flank(smooth, burst, trough)
    at = np.arange(first, last, dtype=np.float64) + 0.5
    fitted = _run_out(at, rate[first:last] - rest)
    poor = fitted[1] > LARGEST_STD_BINS
    position, std = _timed_run_out(smooth, burst, trough, rest) if poor else fitted
    inside = float(np.clip(position, burst + 0.5, trough + (trough - burst)))
    return inside, std + abs(position - inside)


def _burst_before(smooth: NDArray[np.float64], trough: int, level: float) -> int:
    """Return the top of the burst before a trough."""
    at = trough
    while at > 0 and smooth[at] < level:
        at -= 1
    while at > 0 and smooth[at - 1] > smooth[at]:
        at -= 1
    return at


def _flank(smooth: NDArray[np.float64], burst: int, trough: int) -> tuple[int, int]:
    """Return the range of bins of the straight part between a burst and a trough."""
    height = smooth[burst] - smooth[trough]
    part = (smooth[burst : trough + 1] - smooth[trough]) / height
    first = burst + int(np.flatnonzero(part >= FLANK[1])[-1])
    last = first + int(np.flatnonzero(part[first - burst :] <= FLANK[0])[0]) + 1
    missing = max(0, FEWEST_BINS - (last - first))
    return max(0, first - (missing + 1) // 2), min(len(smooth), last + missing // 2)


def _run_out(at: NDArray[np.float64], height: NDArray[np.float64]) -> tuple[float, float]:
    """Return where a falling line through samples reaches zero, and its standard deviation."""
    middle = float(at.mean())
    u = at - middle
    slope = float(u @ height) / float(u @ u)
    mean = float(height.mean())
    if slope >= -1e-9 * (1.0 + abs(mean)):
        return middle, float(np.ptp(at))
    scatter = height - mean - slope * u
    variance = float(scatter @ scatter) / max(1, len(at) - 2)
    beyond = -mean / slope
    spread = variance / slope**2 * (1.0 / len(at) + beyond**2 / float(u @ u))
    return middle + beyond, float(np.sqrt(spread))


def _timed_run_out(
    smooth: NDArray[np.float64], burst: int, trough: int, rest: float
) -> tuple[float, float]:
    """Return the same from the times at which the rate last falls through each level.

    Times are regressed on levels: here it is the times that scatter.
    """
    height = smooth[burst] - smooth[trough]
    levels = smooth[trough] + LEVELS * height
    span = smooth[burst : trough + 1]
    last = np.array([np.flatnonzero(span >= level)[-1] for level in levels])
    times = burst + last + 0.5 + (span[last] - levels) / (span[last] - span[last + 1])
    u = levels - levels.mean()
    slope = float(u @ times) / float(u @ u)
    above = float(levels.mean()) - rest
    scatter = times - times.mean() - slope * u
    variance = float(scatter @ scatter) / (len(times) - 2)
    spread = variance * (1.0 / len(times) + above**2 / float(u @ u))
    return float(times.mean()) - slope * above, float(np.sqrt(spread))
