# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the virtual sensor, the virtual grasp and the virtual arm."""

from __future__ import annotations

from dataclasses import dataclass

from mixtac_core.node import topics
from mixtac_core.node.parameters import fixed, parameter
from mixtac_sim.world.effects import PRESETS
from mixtac_sim.world.profiles import PROFILES


@dataclass(frozen=True)
class VirtualCameraParameters:
    """The simulated sensor and its camera.

    Attributes:
        device_seed: Seed of the simulated sensor: beads, gel, mesh, lens, lamp, pixels, and the
            serial number of its camera
        seed: Seed of the trial: contact point, noise, drifts and clocks
        preset: Difficulty preset of the simulated sensor: paper_like and hard add effects of a real
            bench
        skew_ppm: Rate of the camera's clock over the host's, less one
        socket: Socket on which the virtual camera listens. If empty, the socket that the driver
            opens with `device:=virtual`
    """

    device_seed: int = fixed(1, within=(0, 9_999_999))
    seed: int = fixed(1, within=(0, None))
    preset: str = fixed('easy', choices=tuple(PRESETS))
    skew_ppm: float = fixed(17.0, unit='ppm', within=(-500.0, 500.0))
    socket: str = fixed('')


@dataclass(frozen=True)
class VirtualSensorParameters(VirtualCameraParameters):
    """The virtual sensor, its scenario, and the topics of its bench.

    Attributes:
        scenario: Force profile that ~/play starts; demo begins and ends with two synchronising
            impulses
        seconds: Length of the scenario
        lead_seconds: Delay of the start of a scenario, which is computed up to twice as far ahead
            meanwhile, 45 s at most. Gestures and camera settings during a scenario are delayed by
            up to twice this time
        publish_clock: Publish simulated time on /clock, for nodes with use_sim_time: a slow host
            then slows down all nodes alike
        play_on_start: Play the scenario once a driver reads the camera
        loop: Repeat the scenario without end, each time with a new seed
        reference_topic: Topic of the reference force sensor
    """

    scenario: str = parameter('demo', choices=tuple(PROFILES))
    seconds: float = parameter(25.0, unit='s', within=(1.0, 3600.0))
    lead_seconds: float = parameter(2.0, unit='s', within=(0.0, 30.0))
    publish_clock: bool = fixed(False)
    play_on_start: bool = parameter(False)
    loop: bool = parameter(False)
    reference_topic: str = fixed(topics.REFERENCE)


@dataclass(frozen=True)
class VirtualGraspParameters(VirtualCameraParameters):
    """The object held by the simulated sensor, and the impacts on it.

    Attributes:
        preset: Difficulty preset of the simulated sensor
        object: Object held by the gripper
        margin: Grasp force over the smallest force that holds the object
        knock: Speed that an impact (~/knock) gives the object
        arm_topic: Topic on which the virtual arm publishes its joint positions
        joint_state_topic: Topic of the joint positions that the fingertip has reached
        publish_clock: Publish simulated time on /clock, for nodes with use_sim_time, and let it
            wait for the answers on `slip` and `force_quality`, so that a slow host slows down all
            nodes alike
    """

    preset: str = fixed('paper_like', choices=tuple(PRESETS))
    object: str = fixed('box', choices=('box', 'cup', 'ball'))
    margin: float = fixed(1.05, within=(1.0, 5.0))
    knock: float = parameter(50.0, unit='mm/s', within=(0.0, 500.0))
    arm_topic: str = fixed('/virtual_arm/joint_states')
    joint_state_topic: str = fixed('/joint_states')
    publish_clock: bool = fixed(False)


@dataclass(frozen=True)
class VirtualArmParameters:
    """How the simulated FR3 follows the trajectories that it receives.

    Attributes:
        trajectory_topic: Topic of the trajectories, as for a joint_trajectory_controller
        joint_state_topic: Topic of the published joint states
    """

    trajectory_topic: str = fixed('/fr3_arm_controller/joint_trajectory')
    joint_state_topic: str = fixed('/joint_states')
