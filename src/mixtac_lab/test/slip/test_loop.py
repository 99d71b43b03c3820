# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The whole loop in lock-step: a knocked box is held, and falls without control."""

from dataclasses import replace

import numpy as np
import pytest

from mixtac_lab.slip.loop import ClosedLoop
from mixtac_lab.slip.sensing import Gains, calibrate, sense_grasp
from mixtac_lab.slip.trials import ENABLE_S, KNOCK_S, TrialPlan, run_trial
from mixtac_slip_control.errors import SlipControlError
from mixtac_slip_control.parameters import SlipControlParameters

PLAN = TrialPlan(
    'box', 3, 1.03, knock_mm_s=40.0, stiffness_n_per_mm=5.0, preset='easy', estimated=False
)


def test_a_knocked_box_is_held_within_limits_and_falls_without_control() -> None:
    result, record = run_trial(PLAN)
    assert result['held']
    assert not result['open_held']
    assert result['false_alarms'] == 0
    assert result['limit_violations'] == 0
    assert result['rejected'] == 0
    assert 0.0 < result['detection_ms'] <= 3.0
    assert result['publish_ms'] >= result['detection_ms']
    # The lower bounds begin with the force of the grasp; that of the chain is higher.
    assert result['floor_mm'] < result['chain_mm']
    # It has pressed to the margin before the knock; the rest is the answer.
    pressed = record.advance_mm[record.t_us < 1e6 * KNOCK_S].max()
    assert result['knock_share'] == pytest.approx(1.3, abs=0.1)
    assert record.advance_mm[-1] > pressed + 5e-3
    assert result['peak_n'] < PLAN.settings.max_force
    assert result['stopped'] == ''


def test_on_the_sensors_own_force_the_margin_rises_before_the_knock() -> None:
    plan = replace(PLAN, estimated=True, margin=1.0)
    result, _ = run_trial(plan)
    assert result['held']
    assert result['stopped'] == ''
    assert result['knock_share'] > 1.05
    assert result['peak_n'] < plan.settings.max_force


def test_a_calibrated_sensor_measures_force_and_pull_of_a_grasp() -> None:
    """The calibration, which takes longest, is that of the trial before."""
    plan = TrialPlan('box', PLAN.seed, margin=1.3, preset=PLAN.preset)
    grasp = plan.grasp(camera=True)
    gains = calibrate(plan.seed, plan.seed, plan.preset)
    assert gains != Gains()
    force, found = sense_grasp(grasp, gains), []
    for _ in range(300):
        block = grasp.advance(np.zeros(8))
        found += force.advance(block.events, block.frames, int(block.t_us[-1]))
    last = found[-1]
    assert last.valid
    assert last.deviation is not None
    assert last.shear is not None
    # The gains are those of a hemisphere, the object is a box.
    assert last.force == pytest.approx(block.normal_n[-1], rel=0.5)
    # The object pulls the skin down.
    assert -last.shear.y == pytest.approx(block.pull_n[-1], rel=0.5)
    assert last.end_us == pytest.approx(300_000, abs=2000)


def test_enabling_before_the_background_is_known_is_refused() -> None:
    loop = ClosedLoop(replace(PLAN).grasp(camera=True), SlipControlParameters())
    with pytest.raises(SlipControlError):
        loop.run(0.2, 0.1)
    assert ENABLE_S > 0.1
