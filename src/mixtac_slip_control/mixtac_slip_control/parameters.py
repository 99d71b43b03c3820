# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the slip control node, and the settings of its parts that follow from them."""

from __future__ import annotations

from dataclasses import dataclass, field

from mixtac_node.parameters import parameter
from mixtac_slip_control.background import BackgroundSettings
from mixtac_slip_control.bounds import ProbeSettings, StiffnessSettings
from mixtac_slip_control.detectors import (
    DETECTORS,
    CountSettings,
    FlowSettings,
    HysteresisSettings,
    JudgeSettings,
)
from mixtac_slip_control.features import GuideSettings
from mixtac_slip_control.law import AdvanceSettings
from mixtac_slip_control.safety import SafetySettings


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


@dataclass(frozen=True, slots=True)
class SlipSettings:
    """Settings of all parts.

    Attributes:
        window_us: Counting window [us].
        guide: Where the contact is in the image.
        judge: Of the detectors.
        advance: Gain and limits of the advance.
        safety: Limits and ages.
        stiffness: What is assumed of the contact's stiffness.
        probe: How it is learned when enabled.
        arm_lag_s: From a commanded to the arm's true place [s]: events of the advance come so much
            later.
        settling_s: Time after enabling in which the arm's controller is led to the measured
            positions and slip is not answered [s].
    """

    window_us: int = 1000
    guide: GuideSettings = field(default_factory=GuideSettings)
    judge: JudgeSettings = field(default_factory=JudgeSettings)
    advance: AdvanceSettings = field(default_factory=AdvanceSettings)
    safety: SafetySettings = field(default_factory=SafetySettings)
    stiffness: StiffnessSettings = field(default_factory=StiffnessSettings)
    probe: ProbeSettings = field(default_factory=ProbeSettings)
    arm_lag_s: float = 4e-3
    settling_s: float = 0.0


def slip_settings(parameters: SlipControlParameters) -> SlipSettings:
    """Return what the core needs of these, in windows.

    Raises:
        SlipControlError: Times too short for the window, or values that contradict.
    """
    return SlipSettings(
        window_us=parameters.window_us,
        guide=GuideSettings(
            centre_px=(parameters.contact_column, parameters.contact_row),
            reach_px=parameters.contact_reach,
        ),
        judge=_judge(parameters),
        advance=_advance(parameters),
        safety=_safety(parameters),
        stiffness=StiffnessSettings(parameters.stiffest_contact, parameters.force_noise),
        probe=ProbeSettings(
            parameters.probe_advance,
            parameters.probe_force,
            parameters.probe_speed * parameters.window,
        ),
        arm_lag_s=parameters.arm_lag,
    )


def _judge(parameters: SlipControlParameters) -> JudgeSettings:
    background = BackgroundSettings(
        learning_windows=_windows(parameters, parameters.learning_time),
        time_constant_windows=parameters.background_time_constant / parameters.window,
        alarm_probability=parameters.false_alarms_per_hour * parameters.window / 3600.0,
        tail_shape=parameters.tail_shape,
    )
    hysteresis = HysteresisSettings(
        parameters.release_ratio, max(1, _windows(parameters, parameters.release_time))
    )
    return JudgeSettings(
        detector=parameters.detector,
        count=CountSettings(
            background=background,
            min_excess=parameters.min_excess,
            advance_events_per_m=1e3 * parameters.advance_events_per_mm,
            hysteresis=hysteresis,
        ),
        flow=FlowSettings(
            background=background,
            min_flow=parameters.min_flow,
            slow_windows=max(2, _windows(parameters, parameters.slow_time)),
            min_slow_flow=parameters.min_slow_flow,
            advance_flow_per_m=1e3 * parameters.advance_flow_per_mm,
            hysteresis=hysteresis,
        ),
        settle_windows=_windows(parameters, parameters.settle_time),
    )


def _advance(parameters: SlipControlParameters) -> AdvanceSettings:
    return AdvanceSettings(
        gain=parameters.gain,
        events_per_m=1e3 * parameters.events_per_mm,
        memory_windows=parameters.memory_time / parameters.window,
        max_step=parameters.max_step,
        max_total=parameters.max_total,
        hold_windows=_windows(parameters, parameters.hold_time),
        back_off_step=parameters.back_off * parameters.window,
        preload_step=parameters.preload_speed * parameters.window,
        force_band=parameters.force_band,
    )


def _safety(parameters: SlipControlParameters) -> SafetySettings:
    return SafetySettings(
        max_events_age=parameters.max_events_age,
        max_force_age=parameters.max_force_age,
        max_joint_age=parameters.max_joint_age,
        max_heartbeat_age=parameters.max_heartbeat_age,
        max_force=parameters.max_force,
        saturation_count=parameters.saturation_count,
    )


def _windows(parameters: SlipControlParameters, seconds: float) -> int:
    return round(seconds / parameters.window)
