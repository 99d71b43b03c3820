# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The clock map of a recording by the best means that it allows."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mixtac_alignment.errors import RefinementError
from mixtac_alignment.refinement import Refinement, refine
from mixtac_alignment.two_impulse import fit_counts

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from mixtac_alignment.clock_fit import ClockFit
    from mixtac_alignment.frame_features import FrameFeatures
    from mixtac_alignment.gel_lag import GelLag
    from mixtac_alignment.impulses import ImpulseSettings
    from mixtac_alignment.rate_history import EventCounts


def align(
    counts: EventCounts,
    force_t_s: NDArray[np.float64],
    force_N: NDArray[np.float64],
    frames: FrameFeatures | None = None,
    settings: ImpulseSettings | None = None,
    lag: GelLag | None = None,
    *,
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
        use_all: Fit all strong impulses by least squares instead of the first and the last.

    Returns:
        The best map, and the refinement if it is one.

    Raises:
        AlignmentError: No trustworthy map; the text says why and what to do.
    """
    first = fit_counts(counts, force_t_s, force_N, settings, use_all=use_all)
    if frames is None:
        return first, None
    try:
        refined = refine(first, frames, force_t_s, force_N, lag)
    except RefinementError:
        return first, None
    return refined.fit, refined
