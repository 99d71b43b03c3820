# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Our trajectories on an arm that knows nothing of them: the FR3 in MuJoCo, pressing a gel."""

from __future__ import annotations

import numpy as np
import pytest

from mixtac_sim.arm.controller import JointTrajectoryController
from mixtac_sim.arm.fr3 import Q_LOWER, Q_UPPER, READY, violations
from mixtac_sim.arm.plant import MujocoArm
from mixtac_slip_control.arm.kinematics import SerialArm
from mixtac_slip_control.arm.limits import JointLimits
from mixtac_slip_control.arm.planner import AdvancePlanner

CYCLE_S = 1e-3
START_S = 100.0
SIDEWAYS = np.array([0.0, 1.0, 0.0])
TRANSPORT_CYCLES = 2


@pytest.fixture(autouse=True)
def mujoco():
    """Skip where MuJoCo is missing."""
    return pytest.importorskip('mujoco', reason='pip install -r requirements/mujoco.txt')


@pytest.mark.parametrize(('n_per_mm', 'advance_mm'), [(10.0, 0.1), (5.0, 0.2), (1.0, 0.5)])
def test_an_advance_reaches_its_place_and_its_force(n_per_mm: float, advance_mm: float) -> None:
    arm = MujocoArm(READY, SIDEWAYS, n_per_mm=n_per_mm, preload_n=0.5)
    planner = AdvancePlanner(SerialArm.fr3(), JointLimits.fr3())
    planner.reset(READY, SIDEWAYS)
    controller = JointTrajectoryController(1.0 / CYCLE_S)
    controller.reset(READY, START_S)
    under_way, commands, joints, forces, places = [], [], [], [], []
    for cycle in range(150):
        now_s = START_S + cycle * CYCLE_S
        # In steps, as slip asks for it: every trajectory replaces one that is under way.
        wanted = 1e-3 * advance_mm * min(max(cycle - 5, 0), 10) / 10
        planned = planner.plan(now_s, wanted, SIDEWAYS)
        if planned is not None:
            under_way.append((cycle + TRANSPORT_CYCLES, planned))
        while under_way and under_way[0][0] <= cycle:
            assert controller.accept(under_way.pop(0)[1], now_s) is None
        command = controller.sample(now_s)[0]
        places.append(float(arm.follow(command, 1)[-1]))
        commands.append(command)
        joints.append(arm.q)
        forces.append(arm.gel_n)
    assert violations(np.stack(commands), CYCLE_S) == 0
    assert np.all((np.stack(joints) > Q_LOWER) & (np.stack(joints) < Q_UPPER))
    assert arm.saturated == 0
    # Servos of a few 100 Nm/rad and more give way to the gel by micrometres.
    assert places[-1] == pytest.approx(advance_mm, abs=2e-3)
    assert forces[-1] == pytest.approx(0.5 + n_per_mm * places[-1], rel=0.03)
    assert arm.contact_n == pytest.approx(forces[-1], rel=0.01)
    # The motion overshoots neither place nor force by more than a tenth of the advance.
    assert max(places) < 1.1 * advance_mm
    assert max(forces) < 0.5 + 1.1 * n_per_mm * advance_mm
    # And it is where it was commanded to be, a few milliseconds ago.
    halfway = next(k for k, place in enumerate(places) if place > 0.5 * advance_mm)
    assert 8 < halfway < 60
