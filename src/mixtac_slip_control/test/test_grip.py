# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
import math
from dataclasses import replace

import numpy as np
import pytest

from mixtac_slip_control.grip import GAIN_SPREAD, GripMargin, GripperGoal, above
from mixtac_slip_control.parameters import SlipControlParameters

PARAMETERS = SlipControlParameters(friction=0.65, friction_deviation=0.25, grip_margin=1.3)
STEP_US = 2000


def hold(grip, normal, pull, seconds=1.5, start_us=0):
    """Let a grasp rest; return the time at its end [us]."""
    end_us = start_us + round(1e6 * seconds)
    for stamp_us in range(start_us, end_us, STEP_US):
        grip.on_force(normal, pull, stamp_us, still=True)
    return end_us


def slip(grip, normal, pull, start_us):
    """Let the object slip at a pull; return the time at which it rests again [us]."""
    grip.on_slip(start_us)
    for stamp_us in range(start_us, start_us + 20_000, STEP_US):
        grip.on_force(normal, pull, stamp_us, still=False)
    return start_us + 20_000


@pytest.mark.parametrize(('mean', 'spread', 'least'), [(0.0, 1.0, -1.0), (0.5, 0.2, 0.9)])
def test_a_normal_variable_above_a_value_has_the_moments_of_its_samples(mean, spread, least):
    samples = np.random.default_rng(0).normal(mean, spread, 2_000_000)
    kept = samples[samples > least]
    assert above(mean, spread, least) == pytest.approx((kept.mean(), kept.std()), abs=3e-3)


def test_far_above_its_mean_a_variable_is_just_above_the_value():
    mean, spread = above(0.0, 0.1, 1.0)
    assert 1.0 < mean < 1.02
    assert 0.0 < spread < 0.02


def test_nothing_is_known_where_nothing_pulls():
    grip = GripMargin(PARAMETERS)
    hold(grip, 0.5, 0.0)
    assert not grip.known
    assert grip.margin == (math.inf, math.inf)
    assert grip.wanted(0.5) == 0.5
    assert grip.friction[0] == pytest.approx(0.65)


def test_an_object_that_holds_more_than_guessed_raises_the_coefficient():
    grip = GripMargin(PARAMETERS)
    hold(grip, 0.5, 0.4)
    friction, spread = grip.measured_friction
    assert 0.8 < friction < 1.0
    assert spread < 0.25
    # A part may be the gains of the sensor.
    assert 0.65 < grip.friction[0] < friction
    assert grip.friction[1] > GAIN_SPREAD / 2.0


def test_what_the_first_estimates_say_does_not_count():
    grip = GripMargin(PARAMETERS)
    rest_us = hold(grip, 0.1, 0.3, seconds=0.1)
    hold(grip, 0.5, 0.2, start_us=rest_us)
    assert grip.measured_friction[0] < 0.75


def test_slips_tell_the_coefficient_in_the_sensors_own_units():
    # A gain of the pull that is wrong by a third is wrong in the slip, too: the margin is right.
    wrong, true_friction = 4.0 / 3.0, 0.8
    grip, now_us = GripMargin(PARAMETERS), 0
    for _ in range(3):
        now_us = hold(grip, 0.5, wrong * 0.2, start_us=now_us)
        now_us = slip(grip, 0.5, wrong * true_friction * 0.5, now_us)
    hold(grip, 0.5, wrong * 0.2, start_us=now_us)
    margin, deviation = grip.margin
    assert grip.slips == 3
    assert margin == pytest.approx(true_friction * 0.5 / 0.2, rel=0.1)
    assert deviation < 0.15 * margin


def test_the_friction_of_objects_is_better_known_than_it_is_measured():
    """Objects and gains as the parameters say, each slipped until the ratio is known."""
    rng, errors = np.random.default_rng(0), []
    objects = math.sqrt(PARAMETERS.friction_deviation**2 - GAIN_SPREAD**2)
    for _ in range(100):
        true_friction = 0.65 * math.exp(rng.normal(0.0, objects))
        gain = math.exp(rng.normal(0.0, GAIN_SPREAD))
        grip, now_us = GripMargin(PARAMETERS), 0
        for _ in range(4):
            now_us = hold(grip, 0.5, gain * 0.15, 0.6, now_us)
            now_us = slip(grip, 0.5, gain * true_friction * 0.5, now_us)
        told = np.array([grip.measured_friction[0], grip.friction[0]])
        errors.append([*np.log(told / true_friction), grip.friction[1]])
    measured, found, deviation = np.array(errors).T
    assert np.std(found) < 0.9 * np.std(measured)
    assert np.std(found) == pytest.approx(np.mean(deviation), rel=0.25)


@pytest.mark.parametrize('true_friction', [0.15, 2.5])
def test_an_object_like_no_other_is_not_taken_for_a_wrong_gain(true_friction):
    grip, now_us = GripMargin(PARAMETERS), 0
    for _ in range(12):
        now_us = slip(grip, 1.0, true_friction, hold(grip, 1.0, 0.1, 0.6, now_us))
    measured, _ = grip.measured_friction
    assert measured == pytest.approx(true_friction, rel=0.15)
    assert abs(math.log(grip.friction[0] / measured)) <= GAIN_SPREAD + 1e-9


def test_a_guess_that_is_sure_lays_all_to_the_sensor():
    grip = GripMargin(replace(PARAMETERS, friction_deviation=0.1))
    slip(grip, 0.5, 0.35, hold(grip, 0.5, 0.2))
    hold(grip, 0.5, 0.2, start_us=2_000_000)
    assert grip.friction[0] == pytest.approx(0.65)


def test_the_wanted_force_keeps_the_margin_and_its_limit():
    grip = GripMargin(PARAMETERS)
    hold(grip, 0.5, 0.35)
    # What held is sure: the coefficient need not be taken lower.
    assert grip.wanted(0.1) == pytest.approx(1.3 * 0.5)
    assert grip.wanted(0.9) == 0.9
    grip.configure(replace(PARAMETERS, max_grip_force=0.55))
    assert grip.wanted(0.1) == 0.55
    assert grip.wanted(0.6) == 0.6
    grip.configure(replace(PARAMETERS, grip_margin=1.0))
    assert grip.wanted(0.1) == 0.1


@pytest.mark.parametrize('read', [0.07, 0.13])
def test_a_light_object_is_held_although_its_pull_is_read_too_small(read):
    # Two standard deviations of the noise less than the true pull of 0.13 N.
    critical = 0.13 / 0.65
    grip = GripMargin(PARAMETERS)
    hold(grip, 1.05 * critical, read)
    assert grip.wanted(0.0) > 1.25 * critical


def test_a_doubled_load_asks_for_more_force():
    grip = GripMargin(PARAMETERS)
    end_us = hold(grip, 0.8, 0.2)
    light = grip.wanted(0.0)
    hold(grip, 0.8, 0.4, start_us=end_us)
    assert grip.wanted(0.0) > 1.3 * light


def test_another_grasp_starts_from_the_guess():
    grip = GripMargin(PARAMETERS)
    now_us = hold(grip, 0.5, 0.4)
    slip(grip, 0.5, 0.45, now_us)
    grip.start()
    assert (grip.slips, grip.known) == (0, False)
    assert grip.friction[0] == pytest.approx(0.65)


def test_a_release_forgets_the_object():
    grip = GripMargin(PARAMETERS)
    now_us = slip(grip, 0.5, 0.45, hold(grip, 0.5, 0.4))
    hold(grip, 0.0, 0.0, start_us=hold(grip, 0.5, 0.4, start_us=now_us))
    assert grip.slips == 0
    assert grip.friction[0] == pytest.approx(0.65)


def test_a_release_forgets_an_object_that_slipped_at_once():
    grip = GripMargin(PARAMETERS)
    now_us = slip(grip, 0.5, 0.9, hold(grip, 0.5, 0.3, seconds=0.3))
    now_us = hold(grip, 0.5, 0.3, seconds=0.01, start_us=now_us)
    assert grip.slips == 1
    hold(grip, 0.0, 0.0, start_us=now_us)
    assert grip.slips == 0
    assert grip.friction[0] == pytest.approx(0.65)


def test_time_without_a_contact_is_no_time_at_rest():
    random, grip, now_us = np.random.default_rng(0), GripMargin(PARAMETERS), 0
    for normal, pull, seconds in ((0.0, 0.0, 2.0), (0.5, 0.15, 0.5), (0.5, 0.24, 1.5)):
        end_us = now_us + round(1e6 * seconds)
        for stamp_us in range(now_us, end_us, STEP_US):
            noise, across = random.normal(0.0, 0.01), random.normal(0.0, 0.02, 2)
            grip.on_force(
                normal + noise, np.hypot(pull + across[0], across[1]), stamp_us, still=True
            )
        now_us = end_us
    same = GripMargin(PARAMETERS)
    hold(same, 0.5, 0.24)
    assert grip.wanted(0.0) == pytest.approx(same.wanted(0.0), rel=0.03)


def test_a_slip_before_the_clock_started_anew_is_left():
    grip = GripMargin(PARAMETERS)
    grip.on_slip(hold(grip, 0.5, 0.3, start_us=10_000_000))
    hold(grip, 0.8, 0.3)
    assert grip.slips == 0
    assert grip.normal == pytest.approx(0.8, abs=0.01)


def test_another_guess_counts_until_something_is_known():
    grip = GripMargin(PARAMETERS)
    grip.configure(replace(PARAMETERS, friction=0.4))
    assert grip.friction[0] == pytest.approx(0.4)
    hold(grip, 0.5, 0.3)
    known = grip.measured_friction
    grip.configure(replace(PARAMETERS, friction=0.9))
    assert grip.measured_friction == known


def test_clocks_that_jump_do_not_move_the_mean_at_once():
    grip = GripMargin(PARAMETERS)
    hold(grip, 0.5, 0.2)
    grip.on_force(1.5, 0.2, 10**12, still=True)
    assert grip.normal < 0.75
    grip.on_force(1.5, 0.2, 0, still=True)
    assert grip.normal < 0.75


def goals(grip, force_n, *, kind='force', seconds=1.0, slipping=False, trusted=True):
    """Return what a gripper at 20 Hz is asked for."""
    parameters = SlipControlParameters(gripper=kind, gripper_rate=20.0, gripper_latency=0.05)
    goal = GripperGoal(parameters, grip)
    found = [
        goal.update(1000 * k, force_n, slipping=slipping, trusted=trusted)
        for k in range(round(1000 * seconds))
    ]
    return [each for each in found if each is not None]


def test_a_gripper_is_asked_for_the_force_of_the_margin_at_its_rate():
    grip = GripMargin(PARAMETERS)
    hold(grip, 0.5, 0.3)
    asked = goals(grip, 0.5)
    assert len(asked) == 20
    assert asked[-1] == pytest.approx(grip.wanted(0.5))
    assert 0.5 < asked[-1] < 1.0
    assert goals(grip, 0.5, slipping=True)[-1] == SlipControlParameters().max_grip_force


def test_a_slip_between_two_turns_of_a_gripper_is_answered():
    grip = GripMargin(PARAMETERS)
    hold(grip, 0.5, 0.3)
    parameters = SlipControlParameters(gripper='force', gripper_rate=20.0)
    for begin in range(0, 50, 7):
        goal = GripperGoal(parameters, grip)
        asked = [
            goal.update(1000 * k, 0.5, slipping=begin < k <= begin + 10, trusted=True)
            for k in range(200)
        ]
        assert max(each for each in asked if each is not None) == parameters.max_grip_force


def test_a_gripper_heeds_a_lower_limit_and_another_grasp():
    grip = GripMargin(PARAMETERS)
    hold(grip, 0.5, 0.3)
    parameters = SlipControlParameters(gripper='force', gripper_rate=20.0)
    goal = GripperGoal(parameters, grip)
    high = goal.update(0, 0.5, slipping=True, trusted=True)
    assert goal.update(100_000, 0.5, slipping=False, trusted=True) == high
    goal.configure(replace(parameters, max_grip_force=0.4))
    assert goal.update(200_000, 0.5, slipping=False, trusted=True) == 0.4
    goal.configure(parameters)
    goal.start()
    assert goal.update(300_000, 0.5, slipping=False, trusted=True) < high


def test_a_late_gripper_closes_without_swinging():
    parameters = SlipControlParameters(gripper='speed', gripper_rate=20.0, gripper_latency=0.2)
    grip = GripMargin(parameters)
    hold(grip, 0.5, 0.4)
    goal = GripperGoal(parameters, grip)
    stiffness, force, speed, highest = parameters.stiffest_contact, 0.5, 0.0, 0.0
    under_way = []
    for k in range(5000):
        asked = goal.update(1000 * k, force, slipping=False, trusted=True)
        if asked is not None:
            under_way.append((k + 200, asked))
        while under_way and under_way[0][0] <= k:
            speed = under_way.pop(0)[1]
        force += stiffness * speed * 1e-3
        highest = max(highest, force)
    wanted = grip.wanted(0.5)
    assert wanted - 0.04 < force <= highest < wanted + 0.02


def test_a_force_that_is_not_trusted_moves_no_gripper():
    grip = GripMargin(PARAMETERS)
    hold(grip, 0.5, 0.3)
    assert goals(grip, 0.5, trusted=False) == []
    assert set(goals(grip, 0.5, kind='speed', trusted=False)) == {0.0}
    assert goals(GripMargin(PARAMETERS), 0.0) == []
