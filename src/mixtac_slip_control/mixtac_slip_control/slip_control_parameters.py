# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the slip control node: each gain with its unit and effect."""

from __future__ import annotations

from dataclasses import dataclass

from mixtac_node.parameters import parameter
from mixtac_slip_control.slip_judge import DETECTORS
from mixtac_slip_control.slip_safety_parameters import SlipSafetyParameters


@dataclass(frozen=True)
class SlipControlParameters(SlipSafetyParameters):
    """How slip is told from the background, how far to advance against it, and what stops it."""

    arm: str = parameter(
        'none',
        'What moves: `none` only reports slip; `fr3` is the shipped model of that arm; anything '
        'else is the path of a URDF file.',
        read_only=True,
    )
    joint_acceleration: float = parameter(
        10.0,
        'Largest acceleration of a joint of an arm from a URDF file, which does not hold it.',
        unit='rad/s^2',
        minimum=0.1,
        maximum=1000.0,
        read_only=True,
    )
    joint_jerk: float = parameter(
        5e3, 'The same for its jerk.', unit='rad/s^3', minimum=1.0, maximum=1e6, read_only=True
    )
    normal_frame: str = parameter(
        'tool',
        'Frame of the contact normal: `tool` is the last link as it stands when enabled, `base` '
        'the first.',
        choices=('tool', 'base'),
        read_only=True,
    )
    normal_x: float = parameter(
        0.0, 'Contact normal, the way the arm advances; of any length.', read_only=True
    )
    normal_y: float = parameter(0.0, 'The same along y.', read_only=True)
    normal_z: float = parameter(1.0, 'The same along z.', read_only=True)
    workspace: str = parameter(
        '-0.8 0.8 -0.8 0.8 0.0 1.2',
        'Where the last link may be: ends of a box along x, y, z of the base frame [m].',
        read_only=True,
    )
    settling_time: float = parameter(
        0.5,
        'Time in which the controller is led to the measured joint positions when enabled; slip '
        'is answered after it.',
        unit='s',
        minimum=0.05,
        maximum=10.0,
    )
    trajectory_topic: str = parameter(
        '/fr3_arm_controller/joint_trajectory',
        'Where trajectories go, reliable: the topic of a joint_trajectory_controller that '
        'interpolates from the desired state.',
        read_only=True,
    )
    joint_state_topic: str = parameter(
        '/joint_states', 'Where the joint positions come from.', read_only=True
    )
    heartbeat_topic: str = parameter(
        'slip_control/heartbeat',
        'Sign of life (`std_msgs/Empty`) of whoever supervises; without it nothing moves.',
        read_only=True,
    )
    detector: str = parameter(
        'flow',
        'Whose word counts: `flow` looks at how the skin moves, `count` is the law of the paper, '
        'which also fires when the force merely changes.',
        choices=DETECTORS,
    )
    window: float = parameter(
        1e-3,
        'Counting window. Longer counts scatter less and answer later; gains and thresholds are '
        'per window.',
        unit='s',
        minimum=2e-4,
        maximum=2e-2,
        read_only=True,
    )
    contact_column: float = parameter(
        173.0, 'Place of the contact in the image.', unit='px', minimum=0.0, read_only=True
    )
    contact_row: float = parameter(
        130.0, 'The same along the rows.', unit='px', minimum=0.0, read_only=True
    )
    contact_reach: float = parameter(
        90.0,
        'Distance from the contact over which the motion of the skin falls to 1/e. Smaller looks '
        'at fewer beads, larger at more noise.',
        unit='px',
        minimum=10.0,
        maximum=1000.0,
        read_only=True,
    )
    learning_time: float = parameter(
        1.0,
        'Time at rest from which the background is first learned.',
        unit='s',
        minimum=0.1,
        maximum=60.0,
    )
    background_time_constant: float = parameter(
        20.0,
        'Time over which the background follows slow changes (temperature, light), at rest only. '
        'Shorter follows faster and learns slow slip away.',
        unit='s',
        minimum=0.5,
        maximum=3600.0,
    )
    settle_time: float = parameter(
        0.1,
        'Time without slip and without advance after which the contact is at rest and the '
        'background follows again.',
        unit='s',
        minimum=0.0,
        maximum=60.0,
    )
    false_alarms_per_hour: float = parameter(
        0.1,
        'Rate at which windows at rest may exceed a threshold; the thresholds follow from the '
        'measured tail of the background. Lower detects later.',
        unit='1/h',
        minimum=1e-6,
        maximum=1e4,
    )
    tail_shape: float = parameter(
        0.1,
        'Shape of the generalised Pareto law by which the measured tail is carried on: 0 is '
        'exponential, more is heavier and raises the thresholds.',
        minimum=0.0,
        maximum=0.9,
    )
    min_excess: float = parameter(
        20.0,
        'Smallest count threshold above the background, for very quiet cameras.',
        unit='events per window',
        minimum=0.0,
        maximum=1e5,
    )
    min_flow: float = parameter(
        0.028,
        'Smallest translation of the skin in a window that means slip, over the contrast '
        'threshold of the pixels. Above what a slow change of the force makes.',
        unit='px',
        minimum=0.0,
        maximum=100.0,
    )
    slow_time: float = parameter(
        4e-3,
        'Time over which translation is summed to find slow slip.',
        unit='s',
        minimum=4e-4,
        maximum=0.1,
    )
    min_slow_flow: float = parameter(
        0.1,
        'Smallest translation within slow_time that means slip, over the contrast threshold of '
        'the pixels.',
        unit='px',
        minimum=0.0,
        maximum=100.0,
    )
    release_ratio: float = parameter(
        0.5,
        'Part of the way from the background to the threshold below which a window is quiet.',
        minimum=0.0,
        maximum=1.0,
    )
    release_time: float = parameter(
        5e-3, 'Quiet time that ends a slip.', unit='s', minimum=2e-4, maximum=1.0
    )
    gain: float = parameter(
        2.0,
        'G of the law: advance over motion of the skin. Higher arrests sooner and presses harder, '
        'never beyond what the measured stiffness allows.',
        minimum=0.0,
        maximum=10.0,
    )
    events_per_mm: float = parameter(
        1e4,
        'C of the law: events per millimetre that the skin moves; k = G / C. Depends on beads, '
        'light and thresholds of the camera.',
        unit='1/mm',
        minimum=1.0,
        maximum=1e7,
    )
    advance_events_per_mm: float = parameter(
        2.5e4,
        'Events that a millimetre of advance makes: raises the count threshold while the arm '
        'moves. Too low lets the advance feed itself, too high makes it deaf meanwhile.',
        unit='1/mm',
        minimum=0.0,
        maximum=1e7,
    )
    advance_flow_per_mm: float = parameter(
        4.0,
        'Translation of the skin that a millimetre of advance makes, over the contrast threshold '
        'of the pixels: raises the flow threshold while the arm moves.',
        unit='px/mm',
        minimum=0.0,
        maximum=1e4,
    )
    arm_lag: float = parameter(
        4e-3,
        'From the commanded to the true place of the arm: when the events of an advance come.',
        unit='s',
        minimum=0.0,
        maximum=0.2,
    )
    memory_time: float = parameter(
        0.01,
        'Time in which the answer to an excess of events fades to 1/e while the slip lasts: a skin '
        'that has been dragged as far as it goes makes no more events. 0 is the law of the paper.',
        unit='s',
        minimum=0.0,
        maximum=0.1,
    )
    max_step: float = parameter(
        1e-4,
        'Largest advance in one window; with window it limits the speed asked for.',
        unit='m',
        minimum=0.0,
        maximum=1e-3,
    )
    max_total: float = parameter(
        1e-3,
        'Largest sum of advances since enabling, whatever the force allows.',
        unit='m',
        minimum=0.0,
        maximum=2e-2,
    )
    hold_time: float = parameter(
        0.3,
        'Time without slip for which the advance is held.',
        unit='s',
        minimum=0.2,
        maximum=3600.0,
    )
    back_off: float = parameter(
        2e-5,
        'Speed of the return towards the preload after hold_time; 0 holds for ever. A slip on the '
        'way ends the return for this enabling.',
        unit='m/s',
        minimum=0.0,
        maximum=1e-2,
    )
    preload_speed: float = parameter(
        1e-4,
        'Speed of the advance that keeps the preload (the force at enabling) as the gel relaxes; '
        '0 does not keep it.',
        unit='m/s',
        minimum=0.0,
        maximum=1e-2,
    )
    force_band: float = parameter(
        0.03, 'Force from the preload within which nothing is done.', unit='N', minimum=0.0
    )

    @property
    def window_us(self) -> int:
        """Counting window [us]."""
        return round(self.window * 1e6)

    @property
    def normal(self) -> tuple[float, float, float]:
        """Contact normal in `normal_frame`."""
        return (self.normal_x, self.normal_y, self.normal_z)
