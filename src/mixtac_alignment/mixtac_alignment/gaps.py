# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Stretches without data, in the events and in the force of a recording."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from mixtac_alignment.errors import GapError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_alignment.rate_history import EventCounts

EVENT_GAP_S: Final = 0.02
"""Silence of the pixels that noise makes impossible: at rest a sensor gives 20 events/ms."""
FEWEST_AT_REST: Final = 40.0
"""Events expected in such a silence, below which it means nothing."""
FORCE_GAP_S: Final = 0.05


def mark_gaps(counts: EventCounts) -> EventCounts:
    """Return counts in which stretches without a single event are marked as lost."""
    bins = max(1, round(EVENT_GAP_S * 1e6 / counts.width_us))
    if float(np.median(counts.counts)) * bins < FEWEST_AT_REST:
        return counts
    silent = np.concatenate([[False], counts.counts == 0, [False]])
    turns = np.flatnonzero(np.diff(silent.astype(np.int8)))
    found = tuple(
        (int(first), int(end))
        for first, end in zip(turns[::2], turns[1::2], strict=True)
        if end - first >= bins
    )
    return replace(counts, lost=counts.lost + found)


def require_continuous(t_s: NDArray[np.float64], largest_s: float = FORCE_GAP_S) -> None:
    """Refuse force samples with a gap, behind which the clock may be another.

    Args:
        t_s: Times of the samples [s].
        largest_s: Gap that is still believed to be lost samples only [s].

    Raises:
        GapError: Samples are further apart than that and four periods.
    """
    if len(t_s) < 3:
        return
    steps = np.diff(t_s)
    worst = int(np.argmax(steps))
    if steps[worst] > max(largest_s, 4.0 * float(np.median(steps))):
        raise GapError(
            f'{steps[worst]:.3f} s without force samples {t_s[worst] - t_s[0]:.2f} s into the '
            'recording: samples were lost or the clock of the force sensor jumped; record again'
        )
