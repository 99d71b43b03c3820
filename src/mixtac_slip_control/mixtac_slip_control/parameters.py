# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the slip control node.

Constants of the method and of the watchdogs are in the modules that use them; a parameter is what
depends on the arm, on the place of the sensor, or on the object.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Final

from mixtac_core.node.parameters import ParameterError, fixed, parameter, specs

STEP: Final = 'step'
"""Name of Mixtac's own law."""
PAPER: Final = 'paper'
"""Name of the law of the paper."""
LAWS: Final = (STEP, PAPER)
"""Names of the laws; the first is the default."""
WINDOW_US: Final = 1000
"""Counting window of the events, as in the paper [us]."""
WINDOW_S: Final = 1e-6 * WINDOW_US
"""Counting window of the events [s]."""
SLIP_RATIO: Final = 1.2
"""Least ratio of the force that answers a slip to the force of the grasp: the gain of the sensor
cancels in it. A sensor that reads 25 % low then still keeps 1.5 N in a grasp of 1.25 N, but for the
overshoot of the press: a few percent in simulation."""
CONTROLLER_PERIOD_S: Final = 1e-3
"""Longest period of the arm's controller that is supported [s]."""


def numbers(name: str, text: str, count: int) -> tuple[float, ...]:
    """Return the numbers in a parameter that lists them.

    Args:
        name: Name of the parameter.
        text: Numbers, separated by spaces.
        count: How many there must be.

    Raises:
        ParameterError: Another number of values, or one that is not a finite number.
    """
    try:
        values = tuple(float(part) for part in text.split())
    except ValueError:
        values = ()
    if len(values) != count or not all(abs(value) < 1e9 for value in values):
        raise ParameterError(f'parameter {name} = {text!r}: give {count} numbers')
    return values


@dataclass(frozen=True)
class SlipControlParameters:
    """How slip is detected, how far the arm advances, and which force it may use.

    Attributes:
        arm: Arm that advances: `none` only reports slip, `fr3` is the Franka Research 3; anything
            else is the path of a URDF file.
        arm_backend: Connection to the arm: `trajectory` publishes to a joint_trajectory_controller;
            other names are entry points of the group `mixtac.arm_backends`.
        controller: Name of the arm's joint_trajectory_controller, with its namespace. Slip control
            publishes to `<controller>/joint_trajectory` and reads `<controller>/controller_state`
            and the controller's parameters.
        joint_state_topic: Topic of the joint positions of the arm.
        joint_acceleration: Joint acceleration limit for arms loaded from a URDF file, which has no
            such field.
        joint_jerk: Joint jerk limit for arms loaded from a URDF file, which has no such field.
        normal_frame: Frame of the contact normal: `tool` is the last link in its pose at enabling,
            `base` is the first link.
        normal: Contact normal x, y and z, along which the arm advances; of any length.
        workspace: Allowed region of the last link: limits of a box along x, y and z of the base
            frame [m].
        lead: Time from a trajectory to the first point that may differ from the trajectory before.
            It must cover the worst transport to the controller and two periods of the controller.
        limit_share: Share of the arm's limits of velocity, acceleration and jerk that is used.
            Lower it for first trials.
        heartbeat_topic: Topic of the heartbeat (`std_msgs/Empty`) of the supervisor; the arm moves
            only while it arrives.
        contact: Column and row of the contact in the image [px]; empty follows the topic `contact`
            and starts in the middle of the image.
        min_flow: Smallest translation of the skin in 1 ms that counts as slip, in pixels per
            contrast threshold. Raise it where slow changes of the force are reported as slip.
        law: Response to slip: `step` presses ahead and answers a slip by one bounded step; `paper`
            is the law of the paper, event count over threshold, and needs `gain`.
        gain: k of the law `paper`: advance per event above the threshold.
        grip_margin: Ratio of the normal force to the force at enabling up to which the law `step`
            presses before any slip. 1 does not press.
        slip_force: Normal force to which the law `step` presses at a slip, at least 1.2 times the
            force at enabling. It never presses for more.
        max_force: Measured normal force above which slip control stops.
        force_share: Share of max_force up to which the arm presses. The rest is for the error of
            the sensor: at the default 2.5 standard deviations of a calibrated force (8 %).
        max_total: Largest advance since enabling, whatever the force allows.
        gripper: Command that is published on `grip` for a gripper: the `force` to hold, a closing
            `speed`, or `none`.

    Raises:
        ParameterError: A value that the schema refuses, or text that is not the numbers it should
            be.
    """

    arm: str = fixed('none')
    arm_backend: str = fixed('trajectory')
    controller: str = fixed('/fr3_arm_controller')
    joint_state_topic: str = fixed('/joint_states')
    joint_acceleration: float = fixed(10.0, unit='rad/s^2', within=(0.1, 1000.0))
    joint_jerk: float = fixed(5e3, unit='rad/s^3', within=(1.0, 1e6))
    normal_frame: str = fixed('tool', choices=('tool', 'base'))
    normal: str = fixed('0 0 1')
    workspace: str = fixed('-0.8 0.8 -0.8 0.8 0.0 1.2')
    lead: float = fixed(6e-3, unit='s', within=(6e-3, 0.2))
    limit_share: float = fixed(0.95, within=(0.01, 1.0))
    heartbeat_topic: str = fixed('slip_control/heartbeat')
    contact: str = fixed('')
    min_flow: float = parameter(0.028, unit='px', within=(1e-4, 100.0))
    law: str = fixed(STEP, choices=LAWS)
    gain: float = parameter(2e-7, unit='m', within=(0.0, 1e-4))
    grip_margin: float = parameter(1.3, within=(1.0, 5.0))
    slip_force: float = parameter(1.0, unit='N', within=(0.01, 100.0))
    max_force: float = parameter(1.5, unit='N', within=(0.01, 100.0))
    force_share: float = parameter(0.83, within=(0.1, 1.0))
    max_total: float = parameter(1e-3, unit='m', within=(0.0, 2e-3))
    gripper: str = fixed('none', choices=('none', 'force', 'speed'))

    def __post_init__(self) -> None:
        """Check every value against the schema."""
        for spec in specs(type(self)):
            object.__setattr__(self, spec.name, spec.check(getattr(self, spec.name)))
        if not any(self.normal_vector):
            raise ParameterError('parameter normal is all zero: give a direction')
        numbers('workspace', self.workspace, 6)
        if self.contact:
            numbers('contact', self.contact, 2)
        if not self.controller.strip('/'):
            raise ParameterError('parameter controller is empty: give the name of the controller')

    @cached_property
    def normal_vector(self) -> tuple[float, ...]:
        """Contact normal (3,) in `normal_frame`, of any length."""
        return numbers('normal', self.normal, 3)

    @cached_property
    def workspace_limits(self) -> tuple[float, ...]:
        """Lower and upper limit along x, y and z [m] (6,)."""
        return numbers('workspace', self.workspace, 6)

    @property
    def contact_place(self) -> tuple[float, float] | None:
        """Column and row of the contact [px]; None to follow the topic `contact`."""
        if not self.contact:
            return None
        column, row = numbers('contact', self.contact, 2)
        return column, row

    @property
    def usable_force(self) -> float:
        """Normal force up to which the arm presses, whatever the grasp [N]."""
        return self.force_share * self.max_force

    def answer_force(self, grasp_n: float) -> float:
        """Return the force that answers a slip [N], for the force of the grasp [N]."""
        return min(max(self.slip_force, SLIP_RATIO * grasp_n), self.usable_force)


Current = Callable[[], SlipControlParameters]
"""Returns the parameters as they are now: parts read them when they need them."""
