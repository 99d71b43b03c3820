# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the virtual grasp node."""

from __future__ import annotations

from dataclasses import dataclass

from mixtac_node.parameters import parameter
from mixtac_sim.presets import PRESETS


@dataclass(frozen=True)
class VirtualGraspParameters:
    """Which object is held by which sensor, and what hits it."""

    object: str = parameter('box', 'What is held.', choices=('box', 'cup', 'ball'), read_only=True)
    margin: float = parameter(
        1.05,
        'Grasp force over the smallest that holds.',
        minimum=1.0,
        maximum=5.0,
        read_only=True,
    )
    knock: float = parameter(
        50.0,
        'Speed that a blow gives the object.',
        unit='mm/s',
        minimum=0.0,
        maximum=500.0,
    )
    knock_every: float = parameter(
        0.0,
        'Time between blows; 0 for only those that ~/knock asks for.',
        unit='s',
        minimum=0.0,
        maximum=3600.0,
    )
    device_seed: int = parameter(1, 'Which sensor.', minimum=0, maximum=9_999_999, read_only=True)
    seed: int = parameter(1, 'Which day, and which object of its kind.', minimum=0, read_only=True)
    preset: str = parameter(
        'paper_like', 'How hard the sensor is.', choices=tuple(PRESETS), read_only=True
    )
    skew_ppm: float = parameter(
        17.0,
        'How much faster than the host the clock of the camera runs.',
        unit='ppm',
        minimum=-500.0,
        maximum=500.0,
        read_only=True,
    )
    socket: str = parameter(
        '',
        'Where the virtual camera listens; empty for the path that device:=virtual looks at.',
        read_only=True,
    )
    joint_state_topic: str = parameter(
        '/joint_states', 'Where the joint positions of the arm come from.', read_only=True
    )
    normal_x: float = parameter(
        0.0, 'Contact normal in the base frame, of length 1.', read_only=True
    )
    normal_y: float = parameter(1.0, 'The same along y.', read_only=True)
    normal_z: float = parameter(0.0, 'The same along z.', read_only=True)
    publish_force: bool = parameter(
        True,
        'Publish the true normal force on `force`, in place of an estimator: none is trained on '
        'these objects.',
        read_only=True,
    )
    publish_clock: bool = parameter(
        False,
        'Publish simulated time on /clock, for nodes with use_sim_time, and let it wait for the '
        'answers on `slip`: a host that cannot keep up then slows down everything alike.',
        read_only=True,
    )
