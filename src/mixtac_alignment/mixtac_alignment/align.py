# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The clock map of a recording by the most precise method that its data allow."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mixtac_alignment.clock_fit import with_drift_prior
from mixtac_alignment.errors import RefinementError
from mixtac_alignment.impulses import ImpulseSettings
from mixtac_alignment.refinement import Refinement, refine
from mixtac_alignment.taps import FEWEST_FRAMES, fit_taps
from mixtac_alignment.two_impulse import fit_counts

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from mixtac_alignment.clock_fit import ClockFit
    from mixtac_alignment.gel_lag import GelLag
    from mixtac_alignment.histories import CellEvents, EventCounts, FrameFeatures


def align(
    counts: EventCounts,
    force_t_s: NDArray[np.float64],
    force_N: NDArray[np.float64],
    frames: FrameFeatures | None = None,
    settings: ImpulseSettings | None = None,
    lag: GelLag | None = None,
    *,
    events: CellEvents | None = None,
    use_all: bool = False,
) -> tuple[ClockFit, Refinement | None]:
    """Fit the clock map to impulses, and refine it where there are frames enough.

    Args:
        counts: Event counts, camera clock.
        force_t_s: Force sample times, reference clock [s], increasing.
        force_N: Normal force [N], either sign.
        frames: Frames, camera clock; none leaves it at the impulses.
        settings: What counts as an impulse.
        lag: What is known of the gel.
        events: Events around the taps at least; with frames, they time the taps better.
        use_all: Fit all strong impulses by least squares instead of the first and the last.

    Returns:
        The best map, and the refinement if it is one.

    Raises:
        AlignmentError: No trustworthy map; the text says why and what to do.
    """
    if frames is None:
        return fit_counts(counts, force_t_s, force_N, settings, use_all=use_all), None
    first = _first(counts, events, frames, force_t_s, force_N, settings, lag, use_all=use_all)
    try:
        refined = refine(first, frames, force_t_s, force_N, lag)
    except RefinementError:
        return first, None
    return refined.fit, refined


def _first(
    counts: EventCounts,
    events: CellEvents | None,
    frames: FrameFeatures,
    force_t_s: NDArray[np.float64],
    force_N: NDArray[np.float64],
    settings: ImpulseSettings | None,
    lag: GelLag | None,
    *,
    use_all: bool,
) -> ClockFit:
    """Return the map from the taps' whole course, or from their flanks where frames are too few."""
    # Memory may hold fewer events than their counts: the first tap may be missing.
    few = events is None or not len(events.t_us) or events.start_us > counts.start_us + 500_000
    if events is None or few or len(frames.start_us) < FEWEST_FRAMES:
        fit = fit_counts(counts, force_t_s, force_N, settings, use_all=use_all)
        return with_drift_prior(fit, (settings or ImpulseSettings()).drift_std)
    return fit_taps(counts, events, frames, force_t_s, force_N, settings, lag, use_all=use_all)
