# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the virtual arm node."""

from __future__ import annotations

from dataclasses import dataclass

from mixtac_node.parameters import parameter


@dataclass(frozen=True)
class VirtualArmParameters:
    """How the simulated FR3 follows the trajectories it is sent."""

    trajectory_topic: str = parameter(
        '/fr3_arm_controller/joint_trajectory',
        'Where trajectories come from, as those of a joint_trajectory_controller.',
        read_only=True,
    )
    joint_state_topic: str = parameter(
        '/joint_states', 'Where the joint states go.', read_only=True
    )
    state_rate: float = parameter(
        250.0, 'Joint states per second.', unit='Hz', minimum=1.0, maximum=1000.0, read_only=True
    )
    update_rate: float = parameter(
        1000.0,
        'Cycles of the emulated controller per second.',
        unit='Hz',
        minimum=100.0,
        maximum=4000.0,
        read_only=True,
    )
    release: str = parameter(
        'jazzy',
        'Whose joint_trajectory_controller is emulated; Humble samples one cycle later.',
        choices=('humble', 'jazzy'),
        read_only=True,
    )
    plant: str = parameter(
        'lag',
        'What follows the commands: lag is a first-order lag of each joint; mujoco is the arm in '
        'MuJoCo (requirements/mujoco.txt), with servos of that lag.',
        choices=('lag', 'mujoco'),
        read_only=True,
    )
    tracking_lag: float = parameter(
        3.5e-3,
        'Time constant with which the arm follows its commands (estimate).',
        unit='s',
        minimum=0.0,
        maximum=0.1,
        read_only=True,
    )
