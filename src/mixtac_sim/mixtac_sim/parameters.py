# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the virtual sensor, the virtual grasp and the virtual arm."""

from __future__ import annotations

from dataclasses import dataclass

from mixtac_node.parameters import parameter
from mixtac_node.topics import CONTACT_FRAME, REFERENCE, REFERENCE_FRAME
from mixtac_sim.mechanics.indenters import LIVE_INDENTERS
from mixtac_sim.world.effects import PRESETS
from mixtac_sim.world.profiles import PROFILES


@dataclass(frozen=True)
class TouchParameters:
    """What the services press, load, drop and vibrate do; all of it may change at run time."""

    object: str = parameter(
        'hemisphere',
        'What touches the sensor on request; only objects with a mass can be put down or dropped',
        choices=tuple(LIVE_INDENTERS),
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
        REFERENCE, 'Topic of the reference force sensor', read_only=True
    )
    reference_frame_id: str = parameter(
        REFERENCE_FRAME, 'Frame of the reference force sensor', read_only=True
    )
    truth_frame_id: str = parameter(
        CONTACT_FRAME, 'Frame of the true contact force', read_only=True
    )


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
