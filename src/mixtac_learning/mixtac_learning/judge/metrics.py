# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Error figures of force estimates, and the calibration of a sensor's stiffness.

Images show deformation, and force is stiffness times deformation: two gels of different stiffness
look the same under forces in the ratio of their stiffnesses. The network assumes the usual gel; one
press with a known force gives the ratio, and nothing else has to be learned again.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from mixtac_core.events.errors import MixtacError
from mixtac_learning.trials.trial import DatasetError


class CalibrationError(MixtacError):
    """A measurement that a sensor cannot be calibrated with."""


@dataclass(frozen=True, slots=True)
class Metrics:
    """Errors of an estimate against the truth.

    Attributes:
        samples: Number of samples.
        mae: Mean absolute error [N].
        rmse: Root mean square error [N].
        r2: Coefficient of determination; nan where the truth does not vary.
        constant_mae: Mean absolute error of the truth's median: what no sensor at all achieves [N].
        peak_truth: Largest true force [N].
        peak_estimate: Largest estimated force [N].
    """

    samples: int
    mae: float
    rmse: float
    r2: float
    constant_mae: float
    peak_truth: float
    peak_estimate: float

    def to_dict(self) -> dict[str, float]:
        """Return the figures by name, without those that do not exist."""
        return {name: value for name, value in asdict(self).items() if np.isfinite(value)}


def measure(truth: NDArray[np.floating], estimate: NDArray[np.floating]) -> Metrics:
    """Compare an estimate with the truth.

    Args:
        truth: True force [N], 1-d.
        estimate: Estimated force [N] at the same times.

    Raises:
        DatasetError: The arrays are empty or differ in shape.
    """
    if truth.shape != estimate.shape or not truth.size:
        shapes = f'{truth.shape} and {estimate.shape}'
        raise DatasetError(
            f'truth and estimate have shapes {shapes}: give two equal, non-empty ones'
        )
    truth, estimate = truth.astype(np.float64), estimate.astype(np.float64)
    error = estimate - truth
    spread = float(np.sum((truth - truth.mean()) ** 2))
    return Metrics(
        samples=truth.size,
        mae=float(np.mean(np.abs(error))),
        rmse=float(np.sqrt(np.mean(error**2))),
        r2=1.0 - float(np.sum(error**2)) / spread if spread > 0.0 else float('nan'),
        constant_mae=float(np.mean(np.abs(truth - np.median(truth)))),
        peak_truth=float(truth.max()),
        peak_estimate=float(estimate.max()),
    )


INTERVALS = {'coverage_68': 1.0, 'coverage_95': 1.96}
"""Half widths of the intervals in standard deviations: 68.3 % and 95 % of a Gaussian."""


def coverage(error: NDArray[np.float64], deviation: NDArray[np.float64]) -> dict[str, float]:
    """Return the part of the windows within each of `INTERVALS`, and `mean_deviation` [N].

    Zero width covers a zero error.

    Args:
        error: Estimate minus known force [N], 1-d.
        deviation: Standard deviation that the model gives [N], 1-d.
    """
    size = np.abs(error)
    covered = {name: float(np.mean(size <= w * deviation)) for name, w in INTERVALS.items()}
    return covered | {'mean_deviation': float(deviation.mean())}


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


def fit_scale(estimate: NDArray[np.floating], truth: NDArray[np.floating]) -> float:
    """Fit the scale of a sensor (parameter `force_scale` of the node).

    It is the median ratio of true force to estimate, weighted with the force.

    Args:
        estimate: Estimates with a scale of 1 [N], 1-d.
        truth: Known force at the same times [N]: a weight at rest, or an aligned reference sensor.

    Raises:
        CalibrationError: Too few samples above `SMALLEST_FORCE_N`, in truth and estimate.
    """
    pressed = (truth > SMALLEST_FORCE_N) & (estimate > 0.1 * SMALLEST_FORCE_N)
    count = int(np.count_nonzero(pressed))
    if count < FEWEST_SAMPLES:
        raise CalibrationError(
            f'{count} samples above {SMALLEST_FORCE_N} N: press until there are {FEWEST_SAMPLES}'
        )
    seen = estimate[pressed]
    ratios = truth[pressed] / seen
    order = np.argsort(ratios)
    weight = np.cumsum(seen[order])
    return float(ratios[order][np.searchsorted(weight, 0.5 * weight[-1])])


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
