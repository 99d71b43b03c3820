# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Error figures of force estimates, and the calibration of a sensor's stiffness.

Images show deformation, and force is stiffness times deformation: two gels of different stiffness
look the same under forces in the ratio of their stiffnesses. The network assumes the usual gel; one
press with a known force gives the ratio, and nothing else has to be learned again.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixtac_fger.validity import Reason
from mixtac_learning.judge.estimators import TrialEstimate
from mixtac_learning.trials.trial import DatasetError

Forces = NDArray[np.floating]


def measure(truth: Forces, estimate: Forces) -> dict[str, float]:
    """Compare an estimate with the truth; all figures but `samples` and `r2` in N.

    Args:
        truth: True force [N], 1-d.
        estimate: Estimated force [N] at the same times.

    Returns:
        `samples`, their number; `mae`, `rmse`; `r2`, the coefficient of determination, absent where
        the truth does not vary; `constant_mae`, the MAE of the truth's median: what no sensor at
        all achieves; `peak_truth`, the largest force.
    """
    truth, estimate = truth.astype(np.float64), estimate.astype(np.float64)
    error = estimate - truth
    spread = float(np.sum((truth - truth.mean()) ** 2))
    found = {
        'samples': truth.size,
        'mae': float(np.mean(np.abs(error))),
        'rmse': float(np.sqrt(np.mean(error**2))),
        'constant_mae': float(np.mean(np.abs(truth - np.median(truth)))),
        'peak_truth': float(truth.max()),
    }
    return found | ({'r2': 1.0 - float(np.sum(error**2)) / spread} if spread > 0.0 else {})


INTERVALS = {'coverage_68': 1.0, 'coverage_95': 1.96}
"""Half widths of the intervals in standard deviations: 68.3 % and 95 % of a Gaussian."""


def across_errors(across: NDArray[np.float64], known: NDArray[np.float64]) -> dict[str, float]:
    """Return the mean absolute errors across the normal, and the mean sizes of the true values.

    Args:
        across: Estimates of force x and y [N] and torque [Nm], nan where unknown, [T, 3 or more].
        known: True values [T, 3].

    Returns:
        `sideways_mae` and `sideways_size` per axis [N], `torque_mae_nmm`, `torque_size_nmm`.
    """
    inside = np.isfinite(across[:, :3]).all(axis=1)
    error, size = np.abs(across[inside, :3] - known[inside]), np.abs(known[inside])
    return {
        'sideways_mae': float(error[:, :2].mean()),
        'sideways_size': float(size[:, :2].mean()),
        'torque_mae_nmm': 1e3 * float(error[:, 2].mean()),
        'torque_size_nmm': 1e3 * float(size[:, 2].mean()),
    }


SMALLEST_FORCE_N = 0.1
"""A calibration needs forces beyond this."""
FEWEST_SAMPLES = 50
"""Samples of such forces that a calibration needs."""


def best_gain(estimate: Forces, truth: Forces) -> float:
    """Return the factor of the estimates with the smallest mean absolute error; 1 if all are 0."""
    used = estimate != 0.0
    if not used.any():
        return 1.0
    ratios = truth[used] / estimate[used]
    order = np.argsort(ratios)
    weight = np.cumsum(np.abs(estimate[used])[order])
    return float(ratios[order][np.searchsorted(weight, 0.5 * weight[-1])])


def fit_scale(estimate: Forces, truth: Forces) -> float:
    """Fit the scale of a sensor (parameter `force_scale` of the node), as `best_gain` does.

    Args:
        estimate: Estimates with a scale of 1 [N], 1-d.
        truth: Known force at the same times [N]: a weight at rest, or an aligned reference sensor.

    Raises:
        DatasetError: Too few samples above `SMALLEST_FORCE_N`, in truth and estimate.
    """
    pressed = (truth > SMALLEST_FORCE_N) & (estimate > 0.1 * SMALLEST_FORCE_N)
    count = int(np.count_nonzero(pressed))
    if count < FEWEST_SAMPLES:
        raise DatasetError(
            f'{count} samples above {SMALLEST_FORCE_N} N: press until there are {FEWEST_SAMPLES}'
        )
    return best_gain(estimate[pressed], truth[pressed])


PEAK_TOLERANCE_S = 0.01
"""The estimate of a peak may come this much earlier or later [s]."""


def peak_error(
    known: NDArray[np.float64], estimate: NDArray[np.float64], interval_s: float
) -> float:
    """Return |estimated - known| / known of the largest known force.

    The estimate is the largest one within `PEAK_TOLERANCE_S` of it. nan where nothing is pressed.
    """
    at = int(np.argmax(known))
    if known[at] <= 0.0:
        return float('nan')
    reach = round(PEAK_TOLERANCE_S / interval_s)
    near = estimate[max(at - reach, 0) : at + reach + 1]
    return float(abs(near.max() - known[at]) / known[at])


ALL = 'all'
"""Row of the figures over all profiles."""


def by_profile(
    estimates: Sequence[TrialEstimate], scales: Mapping[str, float] | None = None
) -> dict[str, dict[str, Any]]:
    """Return the figures of each profile, and those over all under `all`.

    Args:
        estimates: Estimates, at least one.
        scales: Scale of each sensor from another trial, by `TrialEstimate.device`; None for none.
    """
    profiles: dict[str, list[TrialEstimate]] = {}
    for each in estimates:
        profiles.setdefault(each.profile, []).append(each)
    rows = {profile: summarise(chosen, scales) for profile, chosen in profiles.items()}
    return rows | {ALL: summarise(estimates, scales)}


def summarise(
    estimates: Sequence[TrialEstimate], scales: Mapping[str, float] | None = None
) -> dict[str, Any]:
    """Return the figures over trials; forces in N, ratios without unit.

    Returns:
        `trials`; of all windows together the fields of `measure`, `INTERVALS` and `mean_deviation`
        [N], the latter two where the model gives deviations; the mean over
        trials of `peak_error`; errors across the normal (`sideways_mae` per axis [N],
        `torque_mae_nmm`) with the mean sizes of the true values, where they are known; with scales
        `calibrated_mae`.
    """
    known = _joined(e.known for e in estimates)
    figures: dict[str, Any] = measure(known, _joined(e.force for e in estimates))
    figures |= _coverage(estimates)
    peaks = np.array([peak_error(e.known, e.force, e.interval_s) for e in estimates])
    if not np.isnan(peaks).all():
        figures['peak_error'] = float(np.nanmean(peaks))
    pairs = [(e.across, e.known_across) for e in estimates if e.across is not None]
    both = [(a, k) for a, k in pairs if k is not None]
    if both:
        figures |= across_errors(_joined(a for a, _ in both), _joined(k for _, k in both))
    if scales is not None:
        errors = _joined(scales.get(e.device, 1.0) * e.force - e.known for e in estimates)
        figures['calibrated_mae'] = float(np.abs(errors).mean())
    return {'trials': len(estimates)} | {name: round(v, 4) for name, v in figures.items()}


def _joined(arrays: Iterable[NDArray[Any]]) -> NDArray[np.float64]:
    return np.concatenate(list(arrays))


def _coverage(estimates: Sequence[TrialEstimate]) -> dict[str, float]:
    """Return the part of all windows within each of `INTERVALS`, and `mean_deviation` [N].

    Zero width covers a zero error. A model without deviations has none of these figures.
    """
    deviations = [e.deviation for e in estimates if e.deviation is not None]
    if len(deviations) < len(estimates):
        return {}
    size, all_n = np.abs(_joined(e.force - e.known for e in estimates)), _joined(deviations)
    covered = {name: float(np.mean(size <= w * all_n)) for name, w in INTERVALS.items()}
    return covered | {'mean_deviation': float(all_n.mean())}


SLOW_SPAN_S = 0.04
"""Span over which the change of the known force is measured: a frame interval [s]."""
SLOW_N_S = 1.0
"""Largest rate of the known force in a slow window [N/s]."""
RIGHT_N = 0.1
"""Error up to which a force is right [N]."""
RIGHT_DEVIATIONS = 1.96
"""Error up to which a force is right as well, over its standard deviation."""
COLLAPSE_N = 0.2
"""Smallest known force at which an estimate can collapse [N]."""
COLLAPSE_SHARE = 0.35
"""Share of the known force below which an estimate has collapsed."""
COLLAPSE_S = 0.03
"""Shortest collapse [s]."""


def trial_row(each: TrialEstimate) -> dict[str, Any]:
    """Return the figures of one trial or bag; None where the model does not give what they need.

    Returns:
        `bag`, the name; `mae_n` and `rmse_n` [N]; `mae_best_gain_n`, the MAE after the best
        gain of this bag; `frames_held_mae_n`, the MAE of the frames-only force, held until the next
        frame, after the same gain; `slow_mae_n` and `slow_frames_held_mae_n`, both after that gain
        where the known force changes by less than `SLOW_N_S`; `coverage_68` and `coverage_95`;
        `falsely_invalid`, the share of windows that are not valid although the force is right;
        `collapses`, how often the estimate stays far below the force.
    """
    gain = best_gain(each.force, each.known)
    error, gained = each.force - each.known, gain * each.force - each.known
    held = None if each.frames_only is None else np.abs(gain * each.frames_only - each.known)
    reach = max(round(0.5 * SLOW_SPAN_S / each.interval_s), 1)
    around = np.pad(each.known, reach, 'edge')
    change = np.abs(around[2 * reach :] - around[: -2 * reach])
    slow = change <= SLOW_N_S * 2 * reach * each.interval_s
    right = np.abs(error) <= RIGHT_N
    if each.deviation is not None:
        right |= np.abs(error) <= RIGHT_DEVIATIONS * each.deviation
    low = (each.known > COLLAPSE_N) & (gain * each.force < COLLAPSE_SHARE * each.known)
    turns = np.flatnonzero(np.diff(low.astype(np.int8), prepend=0, append=0))
    lasting = np.diff(turns)[::2] * each.interval_s >= COLLAPSE_S
    covered = _coverage([each])
    invalid = None if each.reasons is None else right & (each.reasons != Reason.TRUSTED)
    return {
        'bag': each.name,
        'mae_n': _mean(np.abs(error)),
        'mae_best_gain_n': _mean(np.abs(gained)),
        'rmse_n': round(float(np.sqrt(np.mean(error**2))), 4),
        'frames_held_mae_n': None if held is None else _mean(held),
        'slow_mae_n': _mean(np.abs(gained[slow])),
        'slow_frames_held_mae_n': None if held is None else _mean(held[slow]),
        **{name: round(covered[name], 4) if covered else None for name in INTERVALS},
        'falsely_invalid': None if invalid is None else _mean(invalid),
        'collapses': int(np.count_nonzero(lasting)),
    }


def _mean(values: NDArray[Any]) -> float | None:
    return round(float(values.mean()), 4) if len(values) else None
