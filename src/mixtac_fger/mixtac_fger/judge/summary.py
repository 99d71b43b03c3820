# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Figures of a model over trials."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mixtac_fger.judge.coverage import coverage_figures
from mixtac_fger.judge.time_errors import fast_error, peak_error, rolling_errors
from mixtac_fger.metrics import measure

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from mixtac_fger.judge.trial_estimate import TrialEstimate

ALL = 'all'


def by_profile(
    estimates: Sequence[TrialEstimate], scales: Mapping[str, float] | None = None
) -> dict[str, dict[str, Any]]:
    """Return the figures of each profile, and those over all under `all`.

    Args:
        estimates: Estimates, at least one.
        scales: Scale of each sensor from another trial, by `TrialEstimate.device`; None for none.
    """
    profiles = list(dict.fromkeys(each.profile for each in estimates))
    rows = {
        profile: summarise([each for each in estimates if each.profile == profile], scales)
        for profile in profiles
    }
    return rows | {ALL: summarise(estimates, scales)}


def summarise(
    estimates: Sequence[TrialEstimate], scales: Mapping[str, float] | None = None
) -> dict[str, Any]:
    """Return the figures over trials; forces in N, ratios without unit.

    Returns:
        `trials`; of all windows together what `Metrics` holds; the means over trials of
        `peak_error` and of `fast_mae` with `fast_constant_mae`, and of the rolling error in the
        first and last half second and at its worst; `reference_mae` against the measured reference
        where the true force is what counts otherwise; `frames_only_mae` where the model has such an
        output; what `coverage_figures` gives; `calibrated_mae`, `calibrated_rmse` with the scales.
    """
    known = np.concatenate([each.known for each in estimates])
    pooled = measure(known, np.concatenate([each.force for each in estimates]))
    figures: dict[str, Any] = {'trials': len(estimates)} | pooled.to_dict()
    figures |= _over_time(estimates) | coverage_figures(estimates)
    measured = [np.abs(e.force - e.reference) for e in estimates if e.reference is not None]
    framed = [np.abs(e.frames_only - e.known) for e in estimates if e.frames_only is not None]
    for name, errors in (('reference_mae', measured), ('frames_only_mae', framed)):
        if errors:
            figures[name] = _rounded(float(np.concatenate(errors).mean()))
    if scales is not None:
        scaled = [each.scaled(scales.get(each.device, 1.0)).force for each in estimates]
        after = measure(known, np.concatenate(scaled))
        figures['calibrated_mae'] = _rounded(after.mae)
        figures['calibrated_rmse'] = _rounded(after.rmse)
    return figures


def _over_time(estimates: Sequence[TrialEstimate]) -> dict[str, float]:
    rows = []
    for each in estimates:
        interval_s = _interval_s(each)
        fast, fast_constant = fast_error(each.known, each.force, interval_s)
        rolling = rolling_errors(each.known, each.force, interval_s)
        peak = peak_error(each.known, each.force, interval_s)
        rows.append((peak, fast, fast_constant, rolling[0], rolling[-1], rolling.max()))
    names = (
        'peak_error',
        'fast_mae',
        'fast_constant_mae',
        'rolling_first_mae',
        'rolling_last_mae',
        'rolling_worst_mae',
    )
    table = np.array(rows, np.float64)
    return {
        name: _rounded(float(np.nanmean(column)))
        for name, column in zip(names, table.T, strict=True)
        if not np.isnan(column).all()
    }


def _interval_s(estimate: TrialEstimate) -> float:
    return float(np.median(np.diff(estimate.t_us))) / 1e6 if len(estimate.t_us) > 1 else 0.002


def _rounded(value: float) -> float:
    return round(value, 4)
