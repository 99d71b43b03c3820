# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the slip control node: the settings of detectors, law, bounds, watchdogs and arm.

Every part takes this one object. Parameters are in SI units, except where a millimetre is what one
measures; the properties give the parts the same values per window and per metre.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

from mixtac_node.parameters import ParameterError, fixed, parameter, specs

DETECTORS: Final = ('flow', 'count')
"""Names of the detectors; the first is the default."""
LIBFRANKA: Final = 'libfranka'
"""Backend that drives an FR3 without ros2_control."""
FEWEST_LEARNED: Final = 50
"""Fewest windows from which the background is learned: its tail is the highest tenth of them."""
FEWEST_FOLLOWED: Final = 100
"""Fewest windows over which the background follows changes: less, and single windows move it."""
LEAST_REACH_PX: Final = 10.0
"""Shortest reach of the contact: a few bins of the image gradient."""
ADJUSTABLE_WHILE_ENABLED: Final = frozenset(
    ('gain', 'max_step', 'hold_time', 'back_off', 'preload_rate', 'preload_speed', 'force_band')
)
"""Parameters that may change while slip control is enabled; the others set what protects the arm or
would make the detectors learn again."""


@dataclass(frozen=True)
class SlipControlParameters:
    """How slip is detected, how far to advance against it, and what stops slip control.

    Attributes:
        arm: Arm that is moved: `none` only reports slip, `fr3` is the shipped model of the Franka
            Research 3, `libfranka` is the same, driven by the backend of that name; anything else
            is the path of a URDF file.
        arm_backend: What drives the arm: `trajectory` publishes to a joint_trajectory_controller;
            `libfranka` (experimental) drives an FR3 through pylibfranka without ros2_control; other
            names are entry points of the group `mixtac.arm_backends`.
        arm_address: Network address of the arm, for backends that connect to it themselves
            (libfranka).
        arm_python: Python interpreter with pylibfranka and NumPy that runs the control loop of the
            libfranka backend; empty: the node's own.
        arm_realtime: Whether the libfranka backend refuses to run on a kernel without real-time
            scheduling.
        joint_acceleration: Joint acceleration limit for arms loaded from a URDF file (URDF has no
            such field).
        joint_jerk: Joint jerk limit for arms loaded from a URDF file (URDF has no such field).
        normal_frame: Frame of the contact normal: `tool` is the last link in its pose at enabling,
            `base` is the first link.
        normal_x: x component of the contact normal, along which the arm advances; any length.
        normal_y: y component of the contact normal, along which the arm advances; any length.
        normal_z: z component of the contact normal, along which the arm advances; any length.
        workspace: Allowed region of the last link: limits of a box along x, y and z of the base
            frame [m].
        settling_time: Time after enabling in which the arm's controller is led to the measured
            joint positions; slip is answered afterwards. Not used by backends that report commanded
            positions.
        trajectory_topic: Topic to which trajectories are published, reliable: that of a
            joint_trajectory_controller that interpolates from the desired state.
        joint_state_topic: Topic of the joint positions of the arm.
        controller_state_topic: Topic on which the controller reports what it commands
            (`control_msgs/JointTrajectoryControllerState`): slip control starts from the commanded
            positions, and stops when a trajectory came too late or another client moves the arm.
            `none` does without, and sees neither before the arm is elsewhere.
        lead: Time from a trajectory to the first point that may differ from the one before. It must
            cover the worst transport to the controller and two of its periods. Less than 6 ms needs
            the controller state, and a measured transport that allows it.
        interval: Least time between two trajectories.
        controller_period: Period of the arm's controller.
        limit_share: Share of the joints' limits of velocity, acceleration and jerk that is used.
        max_speed: Largest speed of the fingertip.
        heartbeat_topic: Topic of the heartbeat (`std_msgs/Empty`) of the supervisor; the arm moves
            only while it arrives.
        frame_id: Frame of the `slip` messages: z points from the contact into the gel.
        detector: Detector that decides: `flow` uses skin motion, `count` is the law of the paper,
            which also fires when the force merely changes.
        window: Counting window. Longer windows scatter less and answer later; gains and thresholds
            are per window.
        contact_column: Column of the contact in the image; -1 is where `contact` says, and the
            middle of the image before it does.
        contact_row: Row of the contact in the image; -1 likewise.
        contact_reach: Distance from the contact over which the motion of the skin falls to 1/e.
            Smaller uses fewer beads, larger adds noise. 0 is 9/26 of the shorter side of the image
            (90 px on a DAVIS346).
        learning_time: Time at rest from which the background is first learned.
        background_time_constant: Time over which the background follows slow changes (temperature,
            light), at rest only. Shorter follows faster but also learns slow slip as background.
        settle_time: Time without slip and without advance after which the contact counts as at rest
            and the background is updated again.
        false_alarms_per_hour: Rate at which windows at rest may exceed a threshold; the thresholds
            follow from the measured tail of the background. Lower detects later.
        tail_shape: Shape of the generalised Pareto distribution that extrapolates the measured
            tail: 0 is exponential, larger is heavier and raises the thresholds.
        min_excess: Smallest count threshold above the background, for cameras with very little
            noise.
        min_flow: Smallest translation of the skin in one window that counts as slip, in pixels per
            contrast threshold. Keep it above what a slow change of the force causes.
        slow_time: Time over which translation is summed to find slow slip.
        min_slow_flow: Smallest translation of the skin within slow_time that counts as slip, in
            pixels per contrast threshold.
        release_ratio: A window is quiet below this share of the way from the background to the
            threshold.
        release_time: Quiet time that ends a slip.
        gain: G of the advance law: advance over motion of the skin. Higher arrests sooner and
            presses harder, within what the measured stiffness allows.
        events_per_mm: C of the advance law: events per millimetre of skin motion; k = G / C.
            Depends on beads, light and thresholds of the camera.
        advance_events_per_mm: Events caused by a millimetre of advance: raises the count threshold
            while the arm moves. Too low lets the advance feed itself, too high hides slip during an
            advance.
        advance_flow_per_mm: Translation of the skin caused by a millimetre of advance, in pixels
            per contrast threshold: raises the flow threshold while the arm moves.
        arm_lag: Delay from commanded to actual arm position.
        memory_time: Time in which the answer to an excess of events fades to 1/e while the slip
            lasts: a fully stretched skin causes no more events. 0 is the law of the paper.
        slip_rate: Least rate at which the force rises while the detector `flow` says slip, by the
            measured stiffness: some slips make few events. 0 answers the count alone.
        max_step: Largest advance in one window; max_step / window is the largest speed asked for.
        max_total: Largest total advance since enabling, whatever the force allows. The arm must be
            able to reach that far in a straight line, or enabling is refused.
        hold_time: Time without slip for which the advance is held.
        back_off: Speed of the return towards the preload after hold_time; 0 never returns. A slip
            during the return ends it until slip control is enabled again.
        preload_rate: Rate at which the force is raised to the preload (the force at enabling, or
            what `grip_margin` needs), by the measured stiffness. It must exceed what a load adds.
        preload_speed: Largest speed of that advance; 0 does not keep the preload.
        force_band: Deviation of the force from the preload that is tolerated.
        grip_margin: Normal force over the smallest that holds which the arm keeps, slowly; 1 keeps
            the preload only.
        max_grip_force: Largest normal force that is kept for the margin.
        friction: Friction coefficient of objects on the skin, before what holds and what slips
            have told more.
        friction_deviation: Its relative standard deviation between objects and sensors. Larger
            grips harder until a slip has told it.
        gripper: What is published on `grip` for a gripper: `force` that it shall hold, closing
            `speed`, or `none`.
        gripper_rate: Rate of `grip`: that at which the gripper takes commands.
        gripper_latency: Time from a command until the fingers answer. Longer closes more slowly.
        gripper_speed: Largest closing speed that is asked for.
        max_force: Force above which slip control stops. Advances are bounded by the measured
            stiffness to stay below 90 % of it.
        stiffest_contact: Stiffest plausible contact of gel and object: bounds the first advance,
            until the stiffness is measured.
        force_noise: Standard deviation of a force estimate at rest; weights it in the stiffness
            estimate.
        probe_advance: Largest advance of the slow press after enabling that measures the stiffness
            of the contact; 0 does not probe, which limits the response to the first slip.
        probe_speed: Speed of the probing press.
        probe_force: Force increase at which the probing press stops and waits. Doubling it halves
            the error of the stiffness, but the press is more likely to be taken for a slip.
        max_events_age: Age of the latest event packet above which slip control stops.
        max_force_age: Age of the latest force estimate above which slip control stops.
        max_joint_age: Age of the latest joint states above which slip control stops.
        max_heartbeat_age: Age of the latest heartbeat above which slip control stops.
        max_frame_age: Age of the latest frame above which slip control stops; the flow detector
            needs frames.
        min_contrast: Smallest contrast of the picture at the contact with which the flow detector
            sees slip: root mean square gradient of the log intensity.
        min_force: Mean force below which the contact counts as lost, which stops slip control.
        contact_loss_time: Time over which the force is averaged for `min_force`.
        max_following_error: Largest difference between measured and commanded advance, beyond what
            `arm_lag` explains, above which slip control stops.
        max_displacement: Largest difference of a joint from where the plan leads it, across the
            advance, above which slip control stops.
        saturation_count: Events in a window from which the sensor counts as saturated; slip control
            stops after two such windows in a row.

    Raises:
        ParameterError: A value that the schema refuses, or times too short for the window.
    """

    arm: str = fixed('none')
    arm_backend: str = fixed('trajectory')
    arm_address: str = fixed('')
    arm_python: str = fixed('')
    arm_realtime: bool = fixed(False)
    joint_acceleration: float = fixed(10.0, unit='rad/s^2', within=(0.1, 1000.0))
    joint_jerk: float = fixed(5e3, unit='rad/s^3', within=(1.0, 1e6))
    normal_frame: str = fixed('tool', choices=('tool', 'base'))
    normal_x: float = fixed(0.0)
    normal_y: float = fixed(0.0)
    normal_z: float = fixed(1.0)
    workspace: str = fixed('-0.8 0.8 -0.8 0.8 0.0 1.2')
    settling_time: float = parameter(0.5, unit='s', within=(0.05, 10.0))
    trajectory_topic: str = fixed('/fr3_arm_controller/joint_trajectory')
    joint_state_topic: str = fixed('/joint_states')
    controller_state_topic: str = fixed('/fr3_arm_controller/controller_state')
    lead: float = fixed(6e-3, unit='s', within=(2e-3, 0.2))
    interval: float = fixed(2e-3, unit='s', within=(1e-3, 0.1))
    controller_period: float = fixed(1e-3, unit='s', within=(1e-4, 0.02))
    limit_share: float = fixed(0.95, within=(0.01, 1.0))
    max_speed: float = fixed(0.25, unit='m/s', within=(1e-3, 1.0))
    heartbeat_topic: str = fixed('slip_control/heartbeat')
    frame_id: str = fixed('mixtac_contact')
    detector: str = parameter('flow', choices=DETECTORS)
    window: float = fixed(1e-3, unit='s', within=(2e-4, 2e-2))
    contact_column: float = fixed(-1.0, unit='px', within=(-1.0, 1e4))
    contact_row: float = fixed(-1.0, unit='px', within=(-1.0, 1e4))
    contact_reach: float = fixed(0.0, unit='px', within=(0.0, 1000.0))
    learning_time: float = parameter(1.0, unit='s', within=(0.1, 60.0))
    background_time_constant: float = parameter(20.0, unit='s', within=(0.5, 3600.0))
    settle_time: float = parameter(0.1, unit='s', within=(0.0, 60.0))
    false_alarms_per_hour: float = parameter(0.1, unit='1/h', within=(1e-6, 1e4))
    tail_shape: float = parameter(0.1, within=(0.0, 0.9))
    min_excess: float = parameter(20.0, unit='events per window', within=(0.0, 1e5))
    min_flow: float = parameter(0.028, unit='px', within=(0.0, 100.0))
    slow_time: float = parameter(4e-3, unit='s', within=(4e-4, 0.1))
    min_slow_flow: float = parameter(0.1, unit='px', within=(0.0, 100.0))
    release_ratio: float = parameter(0.5, within=(0.0, 1.0))
    release_time: float = parameter(5e-3, unit='s', within=(2e-4, 1.0))
    gain: float = parameter(2.0, within=(0.0, 10.0))
    events_per_mm: float = parameter(1e4, unit='1/mm', within=(1.0, 1e7))
    advance_events_per_mm: float = parameter(2.5e4, unit='1/mm', within=(0.0, 1e7))
    advance_flow_per_mm: float = parameter(4.0, unit='px/mm', within=(0.0, 1e4))
    arm_lag: float = parameter(4e-3, unit='s', within=(0.0, 0.2))
    memory_time: float = parameter(0.01, unit='s', within=(0.0, 0.1))
    slip_rate: float = parameter(20.0, unit='N/s', within=(0.0, 1e3))
    max_step: float = parameter(1e-4, unit='m', within=(0.0, 1e-3))
    max_total: float = parameter(1e-3, unit='m', within=(0.0, 2e-2))
    hold_time: float = parameter(0.3, unit='s', within=(0.2, 3600.0))
    back_off: float = parameter(2e-5, unit='m/s', within=(0.0, 1e-2))
    preload_rate: float = parameter(0.5, unit='N/s', within=(1e-3, 100.0))
    preload_speed: float = parameter(5e-4, unit='m/s', within=(0.0, 1e-2))
    force_band: float = parameter(0.03, unit='N', within=(0.0, None))
    grip_margin: float = parameter(1.3, within=(1.0, 5.0))
    max_grip_force: float = parameter(1.0, unit='N', within=(0.01, 100.0))
    friction: float = parameter(0.75, within=(0.05, 5.0))
    friction_deviation: float = parameter(0.2, within=(0.01, 1.0))
    gripper: str = fixed('none', choices=('none', 'force', 'speed'))
    gripper_rate: float = parameter(20.0, unit='Hz', within=(0.1, 1000.0))
    gripper_latency: float = parameter(0.05, unit='s', within=(0.0, 5.0))
    gripper_speed: float = parameter(5e-3, unit='m/s', within=(1e-5, 1.0))
    max_force: float = parameter(1.5, unit='N', within=(0.01, 100.0))
    stiffest_contact: float = parameter(2e4, unit='N/m', within=(100.0, 1e6))
    force_noise: float = parameter(0.03, unit='N', within=(1e-4, 1.0))
    probe_advance: float = parameter(5e-5, unit='m', within=(0.0, 1e-3))
    probe_speed: float = parameter(5e-4, unit='m/s', within=(1e-5, 1e-2))
    probe_force: float = parameter(0.1, unit='N', within=(1e-3, 10.0))
    max_events_age: float = parameter(0.02, unit='s', within=(2e-3, 1.0))
    max_force_age: float = parameter(0.05, unit='s', within=(2e-3, 1.0))
    max_joint_age: float = parameter(0.05, unit='s', within=(2e-3, 1.0))
    max_heartbeat_age: float = parameter(0.5, unit='s', within=(0.01, 10.0))
    max_frame_age: float = parameter(0.25, unit='s', within=(0.01, 0.5))
    min_contrast: float = parameter(0.02, unit='1/px', within=(0.0, 1.0))
    min_force: float = parameter(0.03, unit='N', within=(0.0, 100.0))
    contact_loss_time: float = parameter(0.05, unit='s', within=(2e-3, 10.0))
    max_following_error: float = parameter(3e-4, unit='m', within=(1e-5, 1e-2))
    max_displacement: float = parameter(5e-3, unit='rad', within=(1e-4, 0.1))
    saturation_count: int = parameter(8000, within=(10, 1000000))

    def __post_init__(self) -> None:
        """Hold every value to the schema, and the times to the window."""
        for spec in specs(type(self)):
            object.__setattr__(self, spec.name, spec.check(getattr(self, spec.name)))
        for name, fewest in (
            ('learning_time', FEWEST_LEARNED),
            ('background_time_constant', FEWEST_FOLLOWED),
        ):
            seconds = getattr(self, name)
            if self.windows(seconds) < fewest:
                raise ParameterError(
                    f'parameter {name} = {seconds:g} s: give at least {fewest} windows of '
                    f'{self.window:g} s'
                )
        if self.max_events_age < 3.0 * self.window:
            raise ParameterError(
                f'parameter max_events_age = {self.max_events_age:g} s: give at least three times '
                f'window = {self.window:g} s'
            )
        if self.lead < 2.0 * self.controller_period:
            raise ParameterError(
                f'parameter lead = {self.lead:g} s: give at least two of controller_period = '
                f'{self.controller_period:g} s'
            )
        if not self.controller_state_topic:
            raise ParameterError('parameter controller_state_topic is empty: give a topic, or none')
        if self.arm == LIBFRANKA and self.arm_backend not in {'trajectory', LIBFRANKA}:
            raise ParameterError(
                f'parameter arm_backend = {self.arm_backend!r}: leave it out where arm is libfranka'
            )
        if 0.0 < self.contact_reach < LEAST_REACH_PX:
            raise ParameterError(
                f'parameter contact_reach = {self.contact_reach:g} px: give at least '
                f'{LEAST_REACH_PX:g} px, or 0 to follow the size of the image'
            )

    @property
    def model(self) -> str:
        """Model of the arm: `none`, `fr3` or the path of a URDF file."""
        return 'fr3' if self.arm == LIBFRANKA else self.arm

    @property
    def backend(self) -> str:
        """Name of what drives the arm."""
        return LIBFRANKA if self.arm == LIBFRANKA else self.arm_backend

    @property
    def normal(self) -> tuple[float, float, float]:
        """Contact normal in `normal_frame`, of any length."""
        return (self.normal_x, self.normal_y, self.normal_z)

    @cached_property
    def window_us(self) -> int:
        """Counting window [us]."""
        return round(self.window * 1e6)

    @cached_property
    def learning_windows(self) -> int:
        """Windows at rest from which the background is first learned."""
        return self.windows(self.learning_time)

    @cached_property
    def settle_windows(self) -> int:
        """Windows without slip and advance after which the background is updated again."""
        return self.windows(self.settle_time)

    @cached_property
    def slow_windows(self) -> int:
        """Windows over which translation is summed for slow slip."""
        return max(2, self.windows(self.slow_time))

    def windows(self, seconds: float) -> int:
        """Return the number of windows nearest to a time [s]."""
        return round(seconds / self.window)
