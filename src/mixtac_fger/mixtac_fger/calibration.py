# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""One number per manufactured sensor: how much stiffer its gel is than the usual one.

Images show deformation, and force is stiffness times deformation: two gels of different stiffness
look the same under forces in the ratio of their stiffnesses. The network assumes the usual gel;
one press against a known force tells the ratio, and nothing else has to be learned anew.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mixtac_fger.errors import CalibrationError

if TYPE_CHECKING:
    from numpy.typing import NDArray

SMALLEST_FORCE_N = 0.1
"""A calibration needs forces beyond this."""
FEWEST_SAMPLES = 50
"""Samples of such forces that a calibration needs."""


@dataclass(frozen=True, slots=True)
class Calibration:
    """The scale of a sensor.

    Attributes:
        force_scale: True force over estimate: parameter `force_scale` of the node.
        samples: Samples that it was fitted to.
        mae_before: Mean absolute error of these samples without it [N].
        mae_after: The same with it [N].
    """

    force_scale: float
    samples: int
    mae_before: float
    mae_after: float


def fit_scale(estimate: NDArray[np.floating], truth: NDArray[np.floating]) -> Calibration:
    """Fit the scale of a sensor: the median ratio, weighted with the force.

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
    known, seen = truth[pressed], estimate[pressed]
    ratios = known / seen
    order = np.argsort(ratios)
    weight = np.cumsum(seen[order])
    scale = float(ratios[order][np.searchsorted(weight, 0.5 * weight[-1])])
    before, after = (float(np.mean(np.abs(g * seen - known))) for g in (1.0, scale))
    return Calibration(scale, count, before, after)
