# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The clock map from edges that a trigger line gives to the camera and to the reference sensor.

Edges are exact to microseconds, but an edge of one recording has no name in the other: the map is
the one under which the most edges meet. Edges at equal distances meet under many; they are refused
unless both recordings hold the same number.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from mixtac_alignment.clock_fit import MAX_DRIFT, Anchor, ClockFit, fit_clock
from mixtac_alignment.errors import AmbiguousImpulsesError, NoImpulseError

EDGE_STD_S: Final = 2e-6
"""Both stamps are counts of a microsecond, with as much jitter."""
TOLERANCE_S: Final = 2e-3
"""Edges further apart than this, and the drift, are not the same."""
RIVAL: Final = 0.9


def fit_edges(
    camera_us: NDArray[np.int64],
    reference_s: NDArray[np.float64],
) -> ClockFit:
    """Fit the clock map to edges by least squares.

    Args:
        camera_us: Edges at the camera's synchronisation input, camera clock [us], ``int64``.
        reference_s: The same edges on the reference clock [s], ``float64``.

    Raises:
        NoImpulseError: Fewer than two edges in one recording, or none that meet.
        AmbiguousImpulsesError: Edges meet in more than one way.
        ShortBaselineError: Edges too close to each other.
        DriftError: The drift is not believable.
    """
    if min(len(camera_us), len(reference_s)) < 2:
        raise NoImpulseError(
            f'{len(camera_us)} edges on external_edges, from the camera, and {len(reference_s)} on '
            'reference_edges: two of each are needed',
            remedy='record both topics with the trigger line connected, or align by taps',
        )
    camera, reference = np.sort(camera_us), np.sort(reference_s)
    x = (camera - camera[0]).astype(np.float64) * 1e-6
    y = reference - reference[0]
    pairs = _best_pairs(x, y)
    anchors = [Anchor(int(camera[i]), float(reference[j]), EDGE_STD_S) for i, j in pairs]
    return fit_clock(anchors, method='hardware_edges')


def _best_pairs(x: NDArray[np.float64], y: NDArray[np.float64]) -> list[tuple[int, int]]:
    if len(x) == len(y) and len(_pairs(x, y, 0, 0)) == len(x):
        return _pairs(x, y, 0, 0)
    found = [_pairs(x, y, i, j) for i in range(len(x)) for j in range(len(y))]
    best = max(found, key=len)
    if len(best) < 2:
        raise NoImpulseError('no two edges have the same time between them in both recordings')
    for other in found:
        if len(other) > RIVAL * len(best) and not set(other) & set(best):
            raise AmbiguousImpulsesError(
                f'{len(best)} edges meet in more than one way: send them at unequal distances, or '
                'start both recordings before the first edge'
            )
    return best


def _pairs(x: NDArray[np.float64], y: NDArray[np.float64], i: int, j: int) -> list[tuple[int, int]]:
    """Return the pairs that meet when edge i is edge j."""
    expected = x - x[i] + y[j]
    nearest = np.clip(np.searchsorted(y, expected), 1, len(y) - 1)
    nearest -= (expected - y[nearest - 1]) < (y[nearest] - expected)
    allowed = TOLERANCE_S + MAX_DRIFT * np.abs(x - x[i])
    meets = np.abs(y[nearest] - expected) <= allowed
    pairs = [(int(k), int(nearest[k])) for k in np.flatnonzero(meets)]
    return pairs if len({second for _, second in pairs}) == len(pairs) else []
