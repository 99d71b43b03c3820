# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Figures of many trials."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from mixtac_bringup.slip_bench.trial import TrialResult


def quantiles(values: Iterable[float]) -> dict[str, float | None]:
    """Return median and 99th percentile of the numbers among some values; a NaN is a miss.

    A miss is later than everything, so that a percentile that falls on one is None.
    """
    array = np.array(list(values), np.float64)
    late = np.where(np.isfinite(array), array, np.inf)
    if not len(late):
        return {'p50': None, 'p99': None}
    found = np.quantile(late, [0.5, 0.99], method='higher')
    p50, p99 = (round(float(v), 3) if np.isfinite(v) else None for v in found)
    return {'p50': p50, 'p99': p99}


def summary(results: Sequence[TrialResult]) -> dict[str, Any]:
    """Return the figures of some trials for JSON."""
    count = len(results)
    return {
        'trials': count,
        'held_fraction': round(sum(r.held for r in results) / count, 4),
        'open_loop_held_fraction': round(sum(r.open_held for r in results) / count, 4),
        'slip_mm': {
            'mean': _mean(r.slip_mm for r in results),
            **_median(r.slip_mm for r in results),
        },
        'arrest_ms': _median(r.arrest_ms for r in results),
        'floor_slip_mm': _median(r.floor_mm for r in results),
        'floor_arrest_ms': _median(r.floor_ms for r in results),
        'chain_floor_slip_mm': _median(r.chain_mm for r in results),
        'chain_floor_arrest_ms': _median(r.chain_ms for r in results),
        'detection_ms': quantiles(r.detection_ms for r in results),
        'count_ms': quantiles(r.count_ms for r in results),
        'flow_ms': quantiles(r.flow_ms for r in results),
        'publish_ms': quantiles(r.publish_ms for r in results),
        'knock_mm_s': _median(r.knock_mm_s for r in results),
        'stiffness_n_per_mm': _median(r.stiffness_n_per_mm for r in results),
        'grasp_n': _median(r.grasp_n for r in results),
        'knock_share': _median(r.knock_share for r in results),
        'peak_n': _median(r.peak_n for r in results),
        'false_alarms': sum(r.false_alarms for r in results),
        'limit_violations': sum(r.limit_violations for r in results),
        'rejected': sum(r.rejected for r in results),
        'stopped': sum(bool(r.stopped) for r in results),
    }


def _mean(values: Iterable[float]) -> float:
    return round(float(np.mean(list(values))), 4)


def _median(values: Iterable[float]) -> dict[str, float | None]:
    """Return the median and the range in which 80 % lie."""
    array = np.array(list(values), np.float64)
    good = array[np.isfinite(array)]
    if not len(good):
        return {'median': None, 'p10': None, 'p90': None}
    low, middle, high = np.quantile(good, [0.1, 0.5, 0.9])
    return {
        'median': round(float(middle), 3),
        'p10': round(float(low), 3),
        'p90': round(float(high), 3),
    }
