# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Whether the true force lies within the intervals that a model gives as often as it says."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mixtac_fger.judge.trial_estimate import TrialEstimate

INTERVALS = {'coverage_68': 1.0, 'coverage_95': 1.96}
"""Half widths of the intervals in standard deviations: 68.3 % and 95 % of a Gaussian."""


def coverage_figures(estimates: Sequence[TrialEstimate]) -> dict[str, float]:
    """Return the part of all windows within each of `INTERVALS`, and the mean deviation [N].

    Nothing where a model says nothing of its uncertainty. Zero width covers a zero error.

    Args:
        estimates: Estimates, at least one.
    """
    pairs = [(np.abs(e.force - e.known), e.deviation) for e in estimates if e.deviation is not None]
    if len(pairs) < len(estimates):
        return {}
    error = np.concatenate([each for each, _ in pairs])
    deviation = np.concatenate([each for _, each in pairs])
    covered = {name: np.mean(error <= width * deviation) for name, width in INTERVALS.items()}
    figures = covered | {'mean_deviation': deviation.mean()}
    return {name: round(float(value), 4) for name, value in figures.items()}
