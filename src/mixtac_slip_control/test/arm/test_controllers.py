# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The stream under the rules of joint_trajectory_controller on Jazzy, Kilted and Lyrical.

The rules come from ros2_controllers 4.42.1 (Jazzy), 5.17.0 (Kilted) and 6.9.0 (Lyrical). On Jazzy
and Kilted a trajectory replaces the one before and keeps its stamp, also one in the past. From
6.8.0 on `allow_trajectory_replacement`, on by default, lets a trajectory stamped in the past begin
at the time of playback: its points come later by the age of its stamp.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mixtac_sim.arm import READY, JointTrajectoryController, Trajectory, violations
from mixtac_slip_control.arm.kinematics import SerialArm
from mixtac_slip_control.arm.limits import JointLimits
from mixtac_slip_control.arm.model import unsafe_setting
from mixtac_slip_control.arm.planner import AdvancePlanner

SIDEWAYS = np.array([0.0, 1.0, 0.0])
JAZZY = {
    'interpolate_from_desired_state': True,
    'set_last_command_interface_value_as_state_on_activation': False,
    'interpolation_method': 'splines',
}
LYRICAL = JAZZY | {'allow_trajectory_replacement': False}
LYRICAL_DEFAULT = JAZZY | {'allow_trajectory_replacement': True}


class Controller:
    """An emulated controller of a distribution, with its parameters."""

    def __init__(self, parameters: dict[str, object]) -> None:
        self.replaces = bool(parameters.get('allow_trajectory_replacement'))
        self.emulated = JointTrajectoryController()
        self.emulated.reset(READY, 5.0)
        self.active = False

    def accept(self, trajectory: Trajectory, now_s: float) -> None:
        if self.replaces and self.active and trajectory.stamp_s < now_s:
            # It starts at the time of playback: the next cycle, one period ahead.
            cycle_s = np.ceil(1e3 * now_s - 1e-6) * 1e-3
            trajectory = dataclasses.replace(trajectory, stamp_s=float(cycle_s))
        assert self.emulated.accept(trajectory, now_s) is None
        self.active = True


def streamed(parameters: dict[str, object], transport_s: float, seed: int) -> np.ndarray:
    """Return the commands of a stream of random targets, each planned in motion [cycle, joint]."""
    planner = AdvancePlanner(SerialArm.fr3(), JointLimits.fr3())
    planner.reset(READY, SIDEWAYS, 1e-3)
    controller, rng = Controller(parameters), np.random.default_rng(seed)
    under_way: list[tuple[float, Trajectory]] = []
    commands, target = [], 1e-4
    for k in range(400):
        now = 5.0 + 1e-3 * k
        while under_way and under_way[0][0] <= now:
            arrival_s, trajectory = under_way.pop(0)
            controller.accept(trajectory, arrival_s)
        commands.append(controller.emulated.sample(now)[0])
        if k % 12 == 0:
            target = float(rng.uniform(0.0, 1e-3))
        plan = planner.plan(now + 3e-4, target)
        if plan is not None:
            given = Trajectory(plan.stamp_s, plan.times_s, plan.q, plan.dq, plan.ddq)
            under_way.append((now + 3e-4 + transport_s, given))
    return np.stack(commands)


@pytest.mark.parametrize('transport_s', [0.0, 2e-3, 3.9e-3])
@pytest.mark.parametrize('parameters', [JAZZY, LYRICAL])
def test_the_stream_keeps_the_limits_where_slip_control_can_be_enabled(
    parameters: dict[str, object], transport_s: float
) -> None:
    assert unsafe_setting(parameters) == ''
    for seed in range(3):
        assert violations(streamed(parameters, transport_s, seed), 1e-3) == 0


def test_the_default_of_lyrical_breaks_them_and_is_refused() -> None:
    assert 'allow_trajectory_replacement' in unsafe_setting(LYRICAL_DEFAULT)
    assert violations(streamed(LYRICAL_DEFAULT, 2e-3, 0), 1e-3) > 0
