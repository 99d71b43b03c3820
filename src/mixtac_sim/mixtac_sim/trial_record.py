# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What was drawn for a sensor and a day, as plain numbers to keep beside a trial."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from mixtac_sim.conditions import Conditions
    from mixtac_sim.device import DeviceModel
    from mixtac_sim.reference import ReferenceSensor


def describe_device(device: DeviceModel) -> dict[str, Any]:
    """Return the constants of a sensor, JSON-ready; beads and pixels only by their number."""
    return _record(
        {
            'seed': device.seed,
            'layer': asdict(device.layer),
            'mesh_n_per_mm': device.mesh_n_per_mm,
            'stiffening': device.stiffening,
            'prony': asdict(device.prony),
            'friction': device.friction,
            'beads': len(device.markers.x_mm),
            'lens': asdict(device.lens),
            'lighting': asdict(device.lighting),
            'threshold_factor': device.threshold_factor,
            'noise_factor': device.noise_factor,
            'speed_factor': device.speed_factor,
            'hot_pixels': len(device.spread.hot_pixel),
            'frame_burst': device.frame_burst,
            'dn_per_lux_ms': device.dn_per_lux_ms,
        }
    )


def describe_conditions(conditions: Conditions) -> dict[str, Any]:
    """Return the conditions of a trial, JSON-ready."""
    return _record(asdict(conditions))


def describe_reference(reference: ReferenceSensor) -> dict[str, Any]:
    """Return clock, delay and mount of the reference sensor, JSON-ready."""
    return _record(
        {
            'offset_s': reference.offset_s,
            'drift_ppm': reference.drift_ppm,
            'delay_s': reference.delay_s,
            'resonance_hz': reference.mount.resonance_hz,
            'resonance_damping': reference.mount.damping,
        }
    )


def _record(values: dict[str, Any]) -> dict[str, Any]:
    """Return values without numpy's types and tuples."""
    return {key: _plain(each) for key, each in values.items()}


def _plain(value: Any) -> Any:  # noqa: ANN401
    """Return a value without them."""
    if isinstance(value, dict):
        return _record(value)
    if isinstance(value, tuple | list):
        return [_plain(each) for each in value]
    return value.item() if isinstance(value, np.generic) else value
