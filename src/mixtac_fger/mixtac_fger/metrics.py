# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Error figures of force estimates, always beside the best constant."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np

from mixtac_fger.errors import DatasetError

if TYPE_CHECKING:
    from numpy.typing import NDArray


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
        """Return the figures by name, rounded to 0.1 mN, without those that do not exist."""
        values = asdict(self)
        return {name: round(value, 4) for name, value in values.items() if np.isfinite(value)}


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
