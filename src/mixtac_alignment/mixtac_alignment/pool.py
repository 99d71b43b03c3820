# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Constants of one sensor from several of its recordings: lag of its gel, latency of its events.

A recording that shows them badly (slow motion) may stand beside another that shows them well (a
dropped load). The weights of the gel's responses in each recording are taken as a measurement with
a covariance; what the prior contributed is taken out again, so that the prior counts once. The
latency is the mean of how late the taps are under the refined maps. `sensor_timings` groups bags by
the sensor that `dataset.yaml` beside them names.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import yaml

from mixtac_alignment.gel_lag import GelLag
from mixtac_alignment.impulses import ImpulseSettings
from mixtac_alignment.recording import read_recording
from mixtac_events.errors import MixtacError

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

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


DESCRIPTION = 'dataset.yaml'
SENSOR_KEYS = ('device_seed', 'serial')
"""What names the sensor of a recording: in simulated data sets, in recorded ones."""
FEWEST = 2
"""Recordings of a sensor from which pooling begins."""


def sensor_timings(
    bags: Iterable[Path], reference: str, namespace: str
) -> dict[Path, SensorTiming]:
    """Return the constants of the sensor of each bag, for sensors with two refined bags or more.

    Args:
        bags: Bags; `dataset.yaml` beside them says with which sensor each was recorded.
        reference: Topic of the reference force.
        namespace: Namespace of the camera's topics.

    Bags that are refused, or of which no sensor is known, stay out of it.
    """
    sensors: dict[str, list[Path]] = {}
    found: dict[str, list[Refinement]] = {}
    for bag in bags:
        sensor = sensor_of(bag)
        if sensor is None:
            continue
        sensors.setdefault(sensor, []).append(bag)
        try:
            refinement = read_recording(bag, reference, namespace).fit()[1]
        except MixtacError:
            continue
        if refinement is not None:
            found.setdefault(sensor, []).append(refinement)
    timings = {name: pool_sensor(parts) for name, parts in found.items() if len(parts) >= FEWEST}
    return {bag: timings[name] for name, of in sensors.items() if name in timings for bag in of}


def sensor_of(bag: Path) -> str | None:
    """Return which sensor a bag was recorded with, by `dataset.yaml` beside it; None if unknown."""
    try:
        content: Any = yaml.safe_load((bag.parent / DESCRIPTION).read_text(encoding='utf-8'))
        entries = content['trials']
        entry = next(e for e in entries if e['name'] == bag.name)
        device = next(entry[key] for key in SENSOR_KEYS if entry.get(key) not in (None, ''))
    except (OSError, KeyError, TypeError, AttributeError, StopIteration, yaml.YAMLError):
        return None
    return str(device)
