# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A recording, and its clock map by the most precise method that its data allow."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mixtac_alignment.clock_fit import ClockFit, with_drift_prior
from mixtac_alignment.edges import fit_edges
from mixtac_alignment.errors import RefinementError
from mixtac_alignment.gel_lag import GelLag
from mixtac_alignment.histories import CellEvents, EventCounts, FrameFeatures
from mixtac_alignment.parameters import AlignmentParameters
from mixtac_alignment.refinement import Refinement, refine
from mixtac_alignment.taps import FEWEST_FRAMES, fit_taps
from mixtac_alignment.two_impulse import fit_counts

Floats = NDArray[np.float64]


Method = Literal['refined', 'two_impulse', 'paper', 'edges']


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """What both clocks recorded; camera times on the camera clock, the others on the reference's.

    Attributes:
        counts: Event counts, with lost packets marked.
        events: Events by cell; the latest ones where there are very many.
        frames: Frames, or None where there are no exposure times.
        force_t_s: Stamps of the reference sensor [s], ``float64 [n]``, increasing.
        force: Its normal force [N], of either sign.
        edges_us: Edges at the camera's synchronisation input, camera clock [us].
        reference_edges_s: The same edges on the reference clock [s].
    """

    counts: EventCounts
    events: CellEvents
    frames: FrameFeatures | None
    force_t_s: Floats
    force: Floats
    edges_us: NDArray[np.int64]
    reference_edges_s: Floats


def align(
    recording: Recording,
    parameters: AlignmentParameters | None = None,
    lag: GelLag | None = None,
    *,
    method: Method = 'refined',
    use_all: bool = False,
) -> tuple[ClockFit, Refinement | None]:
    """Fit the clock map of a recording.

    Args:
        recording: The recording.
        parameters: What counts as an impulse, latencies, limits of clocks.
        lag: What is known of the gel.
        method: `refined` fits taps and refines the map with the frames, where there are enough of
            them; `two_impulse` fits taps alone; `paper` fits their force peaks and event troughs
            alone; `edges` fits the edges of a trigger line instead of taps.
        use_all: Fit all strong impulses by least squares instead of the first and the last.

    Returns:
        The best map, and the refinement if it is one.

    Raises:
        AlignmentError: No trustworthy map.
    """
    chosen = parameters or AlignmentParameters()
    if method == 'edges':
        return fit_edges(recording.edges_us, recording.reference_edges_s), None
    counts, events, frames = recording.counts, recording.events, recording.frames
    force = (recording.force_t_s, recording.force)
    few = frames is None or len(frames.start_us) < FEWEST_FRAMES
    if frames is None or method == 'paper' or (method == 'two_impulse' and few):
        return fit_counts(counts, *force, chosen, use_all=use_all), None
    # Memory may hold fewer events than their counts: the first tap may be missing.
    forgotten = not len(events.t_us) or events.start_us > counts.start_us + 500_000
    if method == 'refined' and (few or forgotten):
        first = fit_counts(counts, *force, chosen, use_all=use_all)
        first = with_drift_prior(first, chosen.drift_std_rate)
    else:
        first = fit_taps(counts, events, frames, *force, chosen, lag, use_all=use_all)
    if method == 'two_impulse':
        return first, None
    try:
        refined = refine(first, frames, *force, lag)
    except RefinementError:
        return first, None
    return refined.fit, refined
