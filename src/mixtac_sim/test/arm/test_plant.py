# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The FR3 in MuJoCo: geometry, lag, the force of the gel, and no creep."""

from __future__ import annotations

import sys
from unittest.mock import MagicMock

import numpy as np
import pytest

from mixtac_sim import SimulationError
from mixtac_sim.arm.fr3 import Q_LOWER, Q_UPPER, READY, flange_place, fr3_mjcf
from mixtac_sim.arm.plant import STEP_S, MujocoArm

SIDEWAYS = np.array([0.0, 1.0, 0.0])


@pytest.fixture
def mujoco():
    return pytest.importorskip('mujoco', reason='pip install -r requirements/mujoco.txt')


def test_a_missing_package_is_named_with_the_remedy(monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, 'mujoco', None)
    with pytest.raises(SimulationError):
        MujocoArm(READY, SIDEWAYS)


def test_the_flange_is_where_the_kinematics_says(mujoco) -> None:
    model = mujoco.MjModel.from_xml_string(fr3_mjcf())
    data = mujoco.MjData(model)
    assert model.body_mass.sum() == pytest.approx(17.892)
    rng = np.random.default_rng(4)
    for q in rng.uniform(Q_LOWER, Q_UPPER, (20, 7)):
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        assert np.allclose(data.site('flange').xpos, flange_place(q), atol=1e-9)


def test_joints_follow_a_ramp_by_the_lag(mujoco) -> None:
    arm = MujocoArm(READY, SIDEWAYS, lag_s=3.5e-3)
    speed = 0.05
    for k in range(200):
        command = READY + speed * 1e-3 * (k + 1)
        arm.follow(command, 8)
    lag_s = (command - arm.q) / speed
    # MuJoCo's own joint damping and the coupling of the joints add to the setting.
    assert np.all((lag_s > 2e-3) & (lag_s < 6e-3))
    assert arm.saturated == 0


def test_the_gel_is_a_spring_and_nothing_creeps(mujoco) -> None:
    arm = MujocoArm(READY, SIDEWAYS, n_per_mm=5.0, preload_n=1.0)
    assert arm.contact_n == pytest.approx(1.0, abs=0.02)
    # A joint step of 1 urad moves the flange by 0.5 um or less: far from any limit.
    goal, reached = READY.copy(), 0.0
    for _ in range(400):
        goal[0] += 1e-6
        reached = float(arm.follow(goal, 8)[-1])
    for _ in range(200):
        reached = float(arm.follow(goal, 8)[-1])
    expected = 1e3 * (flange_place(goal) - flange_place(READY)) @ SIDEWAYS
    assert reached == pytest.approx(expected, abs=5e-3)
    assert reached > 0.1
    assert arm.contact_n == pytest.approx(1.0 + 5.0 * reached, rel=0.03)
    # Held for half a second under that force, nothing moves any more.
    place, force = arm.flange, arm.contact_n
    for _ in range(500):
        arm.follow(goal, 8)
    assert np.allclose(arm.flange, place, atol=1e-7)
    assert arm.contact_n == pytest.approx(force, abs=1e-3)


def test_without_gravity_compensation_in_the_model_the_arm_sags(mujoco) -> None:
    arm = MujocoArm(READY, SIDEWAYS)
    for _ in range(100):
        arm.follow(READY, 1)
    assert np.abs(arm.torque).max() < 0.05
    text = fr3_mjcf()
    loaded, free = (
        mujoco.MjModel.from_xml_string(t) for t in (text, text.replace(' gravcomp="1"', ''))
    )
    sag = []
    for model in (loaded, free):
        data = mujoco.MjData(model)
        data.qpos[:] = READY
        for _ in range(100):
            mujoco.mj_step(model, data)
        sag.append(np.abs(data.qpos - READY).max())
    assert sag[0] < 1e-6
    assert sag[1] > 1e-3


@pytest.mark.parametrize(('lag_s', 'n_per_mm'), [(0.0, 0.0), (3e-3, -1.0), (float('nan'), 0.0)])
def test_values_that_mean_nothing_are_refused(lag_s: float, n_per_mm: float) -> None:
    with pytest.raises(SimulationError):
        MujocoArm(READY, SIDEWAYS, lag_s, n_per_mm=n_per_mm)


@pytest.mark.parametrize('rate_hz', [600.0, 3000.0])
def test_a_period_that_is_no_whole_number_of_steps_is_refused(monkeypatch, rate_hz) -> None:
    monkeypatch.setitem(sys.modules, 'mujoco', MagicMock())
    with pytest.raises(SimulationError):
        MujocoArm(READY, SIDEWAYS, period_s=1.0 / rate_hz)


def test_the_step_is_that_of_the_model() -> None:
    assert f'timestep="{STEP_S}"' in fr3_mjcf()
