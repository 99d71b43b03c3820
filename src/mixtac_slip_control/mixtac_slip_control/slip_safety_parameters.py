# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of slip control that bound the force and say what stops it."""

from __future__ import annotations

from dataclasses import dataclass

from mixtac_node.parameters import parameter


@dataclass(frozen=True)
class SlipSafetyParameters:
    """Force ceiling, contact and ages."""

    max_force: float = parameter(
        1.5,
        'Force ceiling: stops. Advances are bounded, by the measured stiffness, to stay below 90 % '
        'of it.',
        unit='N',
        minimum=0.01,
        maximum=100.0,
    )
    stiffest_contact: float = parameter(
        2e4,
        'Stiffest plausible contact of gel and object: bounds the first advance, until the '
        'stiffness is measured.',
        unit='N/m',
        minimum=100.0,
        maximum=1e6,
    )
    force_noise: float = parameter(
        0.03,
        'Standard deviation of a force estimate at rest: how much one says of the stiffness.',
        unit='N',
        minimum=1e-4,
        maximum=1.0,
    )
    probe_advance: float = parameter(
        5e-5,
        'After enabling the arm presses slowly by up to so much and returns, to measure the '
        'stiffness of the contact; 0 does not probe, which makes the answer to the first slip '
        'timid.',
        unit='m',
        minimum=0.0,
        maximum=1e-3,
    )
    probe_speed: float = parameter(
        5e-4, 'Speed of that press.', unit='m/s', minimum=1e-5, maximum=1e-2
    )
    probe_force: float = parameter(
        0.1,
        'Growth of the force at which that press stops and waits. Twice as much makes the estimate '
        'twice as good, and is more likely to be taken for a slip.',
        unit='N',
        minimum=1e-3,
        maximum=10.0,
    )
    max_events_age: float = parameter(
        0.02, 'Age of the events that stops.', unit='s', minimum=2e-3, maximum=1.0
    )
    max_force_age: float = parameter(
        0.05, 'Age of the force that stops.', unit='s', minimum=2e-3, maximum=1.0
    )
    max_joint_age: float = parameter(
        0.05, 'Age of the joint states that stops.', unit='s', minimum=2e-3, maximum=1.0
    )
    max_heartbeat_age: float = parameter(
        0.5, 'Age of the heartbeat that stops.', unit='s', minimum=0.01, maximum=10.0
    )
    saturation_count: int = parameter(
        8000,
        'Events in a window from which the sensor is saturated: two such in a row stop.',
        minimum=10,
        maximum=1000000,
    )
