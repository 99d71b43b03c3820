# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The clock map of a recording, from two taps or from the edges of a trigger line.

A trigger line sends the same edges to the camera and to the reference sensor. Their times are exact
to microseconds, but nothing identifies an edge in both recordings. The fit selects the map under
which the most edges coincide. Edges at equal intervals coincide under many maps; they are rejected
unless both recordings contain the same number of edges.
"""

from __future__ import annotations

from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from mixtac_fger.alignment.clock_fit import Anchor, ClockFit, fit_clock
from mixtac_fger.alignment.histories import Recording
from mixtac_fger.alignment.impulses import FORCE_GAP_S, coincidences, pairs_at
from mixtac_fger.alignment.parameters import DEFAULTS, AlignmentParameters
from mixtac_fger.alignment.taps import fit_taps

Method = Literal['taps', 'edges']


def align(
    recording: Recording,
    parameters: AlignmentParameters = DEFAULTS,
    *,
    method: Method = 'taps',
    max_gap_s: float = FORCE_GAP_S,
) -> ClockFit:
    """Fit the clock map of a recording.

    Args:
        recording: The recording.
        parameters: Definition of an impulse, latencies, limits of clocks.
        method: `taps` fits the synchronising impulses, `edges` the edges of a trigger line.
        max_gap_s: Longest stretch without force samples [s].

    Raises:
        AlignmentError: No trustworthy map.
    """
    if method == 'edges':
        edges = recording.edges_us, recording.reference_edges_s
        return fit_edges(*edges, complete=recording.all_edges)
    return fit_taps(recording, parameters, max_gap_s=max_gap_s)


FEWEST_EDGES: Final = 3
"""Two edges are as far apart as two others by chance."""
EDGE_STD_S: Final = 2e-6
"""Both stamps are counts of a microsecond, with as much jitter."""
TOLERANCE_S: Final = 2e-3
"""Edges further apart than this, and the drift, are not the same."""


def arrived_together(camera_ns: NDArray[np.int64], reference_ns: NDArray[np.int64]) -> bool:
    """Return whether edges of both clocks arrived in pairs: then the pairs are the same edges.

    Args:
        camera_ns: When the edges of the camera arrived, in this order [ns], any clock, int64 [n].
        reference_ns: When the edges of the reference arrived, same clock.
    """
    if len(camera_ns) != len(reference_ns) or len(camera_ns) < FEWEST_EDGES:
        return False
    apart = np.abs(camera_ns - reference_ns).max()
    return bool(2 * apart < min(np.diff(camera_ns).min(), np.diff(reference_ns).min()))


def fit_edges(
    camera_us: NDArray[np.int64],
    reference_s: NDArray[np.float64],
    *,
    complete: bool = True,
) -> ClockFit:
    """Fit the clock map to edges by least squares.

    Args:
        camera_us: Edges at the camera's synchronisation input, camera clock [us], ``int64``.
        reference_s: The same edges on the reference clock [s], ``float64``.
        complete: As many on both sides are the same ones, in this order.

    Raises:
        NoImpulseError: Fewer than three edges in one recording, or none that coincide.
        AmbiguousImpulsesError: Edges coincide in more than one way.
        ShortBaselineError: Edges too close to each other.
        DriftError: The drift is not believable.
    """
    camera, reference = np.unique(camera_us), np.unique(reference_s)
    x = (camera - camera[:1]).astype(np.float64) * 1e-6
    y = reference - reference[:1]
    whole = complete and len(x) == len(y) >= FEWEST_EDGES
    pairs = pairs_at(x, y, 0, 0, TOLERANCE_S) if whole else []
    if not pairs or len(pairs) < len(x):
        pairs = coincidences(x, y, tolerance_s=TOLERANCE_S, fewest=FEWEST_EDGES)
    anchors = [Anchor(int(camera[i]), float(reference[j]), EDGE_STD_S) for i, j in pairs]
    return fit_clock(anchors, method='hardware_edges')
