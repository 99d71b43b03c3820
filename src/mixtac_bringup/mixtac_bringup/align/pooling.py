# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the bags of each sensor say together of its gel and its latency."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import yaml

from mixtac_alignment.sensor_pool import SensorTiming, pool_sensor
from mixtac_bringup.align.bag_recording import read_recording
from mixtac_events.errors import MixtacError

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from mixtac_alignment.refinement import Refinement

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
