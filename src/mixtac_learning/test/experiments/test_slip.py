# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The whole loop in lock-step, and the sensor's own force in it."""

from __future__ import annotations

import numpy as np
import pytest

from mixtac_learning.experiments.slip import (
    KNOCK_S,
    SensedForce,
    TrialPlan,
    arrest_of,
    finish_trial,
    press_gain,
    start_trial,
)

PLAN = TrialPlan('box', 3, 1.03, knock_mm_s=40.0, preset='easy')


def test_a_knocked_box_is_held_within_limits_and_falls_without_control() -> None:
    loop = start_trial(PLAN)
    result, course = finish_trial(PLAN, loop), loop.course
    assert result['held']
    assert not PLAN.uncontrolled()['held']
    assert result['false_alarms'] == 0
    assert result['limit_violations'] == 0
    assert result['rejected'] == 0
    assert 0.0 < result['detection_ms'] <= 3.0
    # It has pressed to the margin before the knock; the rest is the answer.
    pressed = course['advance_mm'][course['t_us'] < 1e6 * KNOCK_S].max()
    assert result['knock_share'] > 1.05
    assert result['advance_mm'] > pressed + 5e-3
    assert result['peak_n'] < PLAN.settings.max_force
    assert result['stopped'] == ''


def test_a_calibrated_sensor_measures_the_force_of_a_grasp() -> None:
    """The calibration, which takes longest, is that of the trial before."""
    plan = TrialPlan('box', PLAN.seed, margin=1.3, preset=PLAN.preset)
    grasp = plan.grasp(KNOCK_S, camera=True)
    gain = press_gain(plan.seed, plan.preset)
    assert gain != 1.0
    force, found = SensedForce(grasp, gain), []
    for _ in range(300):
        block = grasp.advance(np.zeros(8))
        found += force.advance(block.events, block.frames, int(block.t_us[-1]))
    last = found[-1]
    assert last.valid
    assert last.deviation is not None
    # The gain is that of a hemisphere, the object is a box.
    assert last.force == pytest.approx(block.normal_n[-1], rel=0.5)
    assert last.end_us == pytest.approx(300_000, abs=2000)


def test_arrest_is_when_the_object_stands_still_for_good() -> None:
    t_us = (np.arange(800) + 1) * 125
    speed = np.zeros(800)
    speed[80:160] = 10.0
    speed[200:240] = 2.0
    arrest = arrest_of(t_us, np.cumsum(speed) * 125e-6, speed, 10_000)
    assert arrest['slip_mm'] == pytest.approx(0.11)
    assert arrest['arrest_ms'] == pytest.approx(20.0)
    assert arrest['held']
    never = arrest_of(t_us, np.linspace(0, 1, 800), np.full(800, 10.0), 10_000)
    assert never['arrest_ms'] is None
    assert not never['held']
