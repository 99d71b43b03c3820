# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the recordings of one sensor say together: the lag of its gel, the latency of its events.

Both are constants of a sensor, and a recording that shows one badly (slow motion) may stand beside
another that shows it well (a dropped load). Each recording's weights of the gel's responses are
taken as a measurement with a covariance; what the prior put into it is taken out again, so that the
prior counts once. The latency is the mean of what the taps show late under the refined maps.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from mixtac_alignment.gel_lag import GelLag
from mixtac_alignment.impulses import ImpulseSettings

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mixtac_alignment.refinement import Refinement

TAP_SCATTER_S: Final = 4.5e-4
"""Scatter of the taps of one sensor about their mean latency."""
LATENCY_FLOOR_S: Final = 1.5e-4
"""Least standard deviation of a pooled latency."""


@dataclass(frozen=True, slots=True)
class SensorTiming:
    """Constants of one sensor.

    Attributes:
        lag: Lag of its gel.
        settings: Settings with the latency of its events and what is left unknown of it.
        recordings: How many recordings it comes from.
    """

    lag: GelLag
    settings: ImpulseSettings
    recordings: int


def pool_lag(refinements: Sequence[Refinement], prior: GelLag | None = None) -> GelLag:
    """Return the lag of the gel that recordings of one sensor show together.

    Args:
        refinements: Refinements that were made with the prior.
        prior: What was known before.
    """
    before = prior or GelLag()
    known = np.diag(1.0 / np.array(before.std) ** 2)
    precision, moment = known.copy(), known @ np.array(before.mean)
    for each in refinements:
        own = np.linalg.inv(each.lag_covariance)
        size, axes = np.linalg.eigh(own - known)
        gained = axes @ np.diag(np.maximum(size, 0.0)) @ axes.T
        shown = np.linalg.pinv(gained, rcond=1e-9, hermitian=True) @ (
            own @ np.array(each.lag.mean) - known @ np.array(before.mean)
        )
        precision += gained
        moment += gained @ shown
    covariance = np.linalg.inv(precision)
    return GelLag(
        tuple(map(float, covariance @ moment)), tuple(map(float, np.sqrt(np.diag(covariance))))
    )


def pool_latency(
    refinements: Sequence[Refinement], settings: ImpulseSettings | None = None
) -> ImpulseSettings:
    """Return settings with the latency of one sensor's events.

    Args:
        refinements: Refinements whose anchors are taps fitted with the same settings.
        settings: Those.
    """
    chosen = settings or ImpulseSettings()
    precision = 1.0 / chosen.tap_latency_std_s**2
    moment = 0.0
    for each in refinements:
        camera_us = np.array([anchor.camera_us for anchor in each.fit.anchors])
        late = -float(np.mean(each.fit.residuals_s))
        middle = int(camera_us.mean())
        variance = float(each.fit.std_at(middle)) ** 2 + TAP_SCATTER_S**2 / len(camera_us)
        precision += 1.0 / variance
        moment += late / variance
    return replace(
        chosen,
        tap_latency_s=chosen.tap_latency_s + moment / precision,
        tap_latency_std_s=float(np.hypot(precision**-0.5, LATENCY_FLOOR_S)),
    )


def pool_sensor(refinements: Sequence[Refinement]) -> SensorTiming:
    """Return the constants of a sensor from its recordings.

    Args:
        refinements: Refinements of its recordings, made with the defaults.
    """
    return SensorTiming(pool_lag(refinements), pool_latency(refinements), len(refinements))
