# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the virtual sensor node."""

from __future__ import annotations

from dataclasses import dataclass

from mixtac_node.parameters import parameter
from mixtac_sim.presets import PRESETS
from mixtac_sim.profiles import PROFILES
from mixtac_sim.touch_parameters import TouchParameters


@dataclass(frozen=True)
class VirtualSensorParameters(TouchParameters):
    """What the virtual sensor is, what touches it and where it is found."""

    device_seed: int = parameter(
        1,
        'Which sensor: fixes what a rebuild would change (beads, stiffness, lamp, pixels) and the '
        'serial number of the camera',
        minimum=0,
        maximum=9_999_999,
        read_only=True,
    )
    seed: int = parameter(
        1, 'Which day: fixes contact, noise, drifts and clocks', minimum=0, read_only=True
    )
    preset: str = parameter(
        'easy',
        'How hard the sensor is: paper_like and hard add effects of a real bench',
        choices=tuple(PRESETS),
        read_only=True,
    )
    scenario: str = parameter(
        'demo',
        'What ~/play plays; demo begins and ends with the two synchronising impulses',
        choices=tuple(PROFILES),
    )
    seconds: float = parameter(
        25.0, 'Length of the scenario', unit='s', minimum=10.0, maximum=3600.0
    )
    play_on_start: bool = parameter(False, 'Play the scenario as soon as a driver reads the camera')
    loop: bool = parameter(False, 'Play the scenario again and again, each time with a new seed')
    socket: str = parameter(
        '',
        'Where the virtual camera listens; empty for the path that device:=virtual looks at',
        read_only=True,
    )
    skew_ppm: float = parameter(
        17.0,
        'How much faster than the host the clock of the camera runs',
        unit='ppm',
        minimum=-500.0,
        maximum=500.0,
        read_only=True,
    )
    reference_topic: str = parameter(
        '/ft_sensor/wrench', 'Topic of the reference force sensor', read_only=True
    )
    reference_frame_id: str = parameter(
        'ft_sensor', 'Frame of the reference force sensor', read_only=True
    )
    truth_frame_id: str = parameter(
        'mixtac_contact', 'Frame of the true contact force', read_only=True
    )
