# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of what users do to the live sensor."""

from __future__ import annotations

from dataclasses import dataclass

from mixtac_node.parameters import parameter
from mixtac_sim.live_objects import OBJECTS


@dataclass(frozen=True)
class TouchParameters:
    """What the services press, load, drop and vibrate do; all of it may change at run time."""

    object: str = parameter(
        'hemisphere',
        'What touches the sensor on request; only objects with a mass can be put down or dropped',
        choices=tuple(OBJECTS),
    )
    press_force: float = parameter(0.5, 'Force of ~/press', unit='N', minimum=0.0, maximum=20.0)
    hold_seconds: float = parameter(
        2.0,
        'How long the object stays; 0 for until ~/release',
        unit='s',
        minimum=0.0,
        maximum=3600.0,
    )
    drop_height: float = parameter(
        50.0, 'Height from which ~/drop lets the object fall', unit='mm', minimum=0.0, maximum=200.0
    )
    vibration_frequency: float = parameter(
        100.0, 'Frequency of ~/vibrate', unit='Hz', minimum=1.0, maximum=500.0
    )
    vibration_amplitude: float = parameter(
        0.05, 'Amplitude of ~/vibrate, zero to peak', unit='mm', minimum=0.0, maximum=1.0
    )
    vibration_depth: float = parameter(
        0.3, 'Mean depth of ~/vibrate', unit='mm', minimum=0.01, maximum=1.5
    )
