# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Sideways force and torsion: what frames show, what events add, gains; nothing else moves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from toy_sensor import random_model

from mixtac_fger.config import (
    TURNING_WIDTHS,
    ConfigError,
    FgerConfig,
    ModelError,
    count_parameters,
    operations_per_cycle,
)
from mixtac_fger.estimator import Estimate, fill_quality
from mixtac_fger.fger_net import FgerEstimator, with_gain, with_sideways_gain
from mixtac_fger.shear import Shear, ShearHead, turning
from mixtac_fger.streaming import ForceEstimator
from mixtac_fger.weights import find_model, read_model

CONFIG = FgerConfig(shear=True)


def tensors():
    """Return a head that reads x and y from the first features of a frame, torque from a moment."""
    weight, gates = (np.zeros((rows, CONFIG.frame_size), np.float32) for rows in (2, 4))
    weight[0, 0] = weight[1, 1] = gates[3, 0] = 1.0
    return {
        'shear.frame.weight': weight,
        'shear.frame.bias': np.float32([0.0, 0.0]),
        'shear.turning.weight': gates,
        'shear.turning.bias': np.float32([0.0, 0.5, 0.0, 0.0]),
        'shear.unit': np.array([2.0, 2.0, 3.0], np.float32),
        'shear.deviation': np.tile(np.float32([0.1, 0.2, 0.5]), (3, 1)),
    }


def shown(x, y, moment=0.0):
    """Return feature and moments of a frame with a torque of (0.5 + x) moments."""
    feature = np.zeros(CONFIG.frame_size, np.float32)
    feature[:2] = x, y
    return feature, np.float32([0.0, moment, 0.0, moment])


def test_a_frame_counts_from_the_centre_of_its_exposure_and_events_carry_it_on():
    head = ShearHead(CONFIG, tensors())
    assert head.value is None
    head.correct(head.measure(*shown(0.3, -0.2)), 0)
    for _ in range(4):
        head.step(np.float32([0.01, 0.0, 0.01]))
    assert head.value[:2] == pytest.approx((2.0 * 0.34, 2.0 * -0.2), rel=1e-5)
    # Exposed two windows ago: only the last two increments come on top.
    head.correct(head.measure(*shown(0.5, 0.0, 0.6)), 2)
    assert head.value[:2] == pytest.approx((2.0 * 0.52, 0.0), rel=1e-5)
    assert head.value.torque == pytest.approx(3e-3 * 0.62, rel=1e-5)
    expected = 2.0 * np.sqrt(0.1**2 + (0.2 * 0.52) ** 2 + (0.5 * 0.02) ** 2)
    assert head.value.deviation == pytest.approx(expected, rel=1e-5)
    head.clear()
    assert head.value is None


ROWS, COLUMNS = CONFIG.frame_shape


def displacement(place, press=0.0, pull=(0.0, 0.0), turn=0.0, width=8.0):
    """Return the displacement [2, rows, columns] under a contact, y downwards [bins]."""
    y, x = np.mgrid[:ROWS, :COLUMNS].astype(float)
    x, y = x - place[0], y - place[1]
    near = np.exp(-(x**2 + y**2) / (2.0 * width**2))
    # Skin moves away from a press; a turn from x to y as the contact frame has them, y upwards.
    moved = press * near * np.stack([x, y]) + near * np.reshape(pull, (2, 1, 1))
    return (moved + turn * near * np.stack([y, -x])).astype(np.float32)


def moments(field):
    out = np.zeros(len(TURNING_WIDTHS), np.float32)
    turning(field, out)
    return out


def test_moments_tell_a_turn_about_a_contact_anywhere_under_any_pull():
    plain = moments(displacement((42.0, 32.0), press=0.1, turn=0.05))
    assert (plain > 0.0).all()
    np.testing.assert_allclose(
        moments(displacement((42.0, 32.0), press=0.1, turn=-0.1)), -2.0 * plain, rtol=1e-3
    )
    for place in ((42.0, 32.0), (36.0, 35.5)):
        for pull in ((1.0, 0.0), (-0.4, 0.9)):
            found = moments(displacement(place, press=0.1, pull=pull, turn=0.05))
            # A pull moves the mean along itself, out of the middle of the narrowest sum.
            np.testing.assert_allclose(found[:3], plain[:3], rtol=0.15)


def test_a_press_and_a_pull_have_no_moment_and_nothing_has_none():
    turned = moments(displacement((42.0, 32.0), press=0.1, turn=0.05))
    for pull in ((0.0, 0.0), (1.0, 0.0), (-0.4, 0.9)):
        found = moments(displacement((40.0, 30.0), press=0.1, pull=pull))
        assert np.abs(found[:3] / turned[:3]).max() < 0.03
    assert not moments(np.zeros((2, ROWS, COLUMNS), np.float32)).any()
    spoilt = displacement((42.0, 32.0), press=0.1)
    spoilt[0, 20, 20] = np.nan
    moments(spoilt)


def test_sideways_force_needs_the_displacement():
    with pytest.raises(ConfigError):
        FgerConfig(shear=True, frame_channels=('difference',))


def test_values_that_are_not_finite_are_unknown():
    head = ShearHead(CONFIG, tensors())
    head.correct(np.array([np.nan, 0.0, 0.0]), 0)
    assert head.value is None


def run(model, trial, **options):
    """Return the estimates of a trial."""
    estimator = ForceEstimator(FgerEstimator(model), assume_free=True, **options)
    rows, start = [], 0
    middle = (trial.exposure_start_us + trial.exposure_end_us) // 2
    for image, mid_us, arrival_us in zip(
        trial.frames, middle.tolist(), trial.arrival_us.tolist(), strict=True
    ):
        rows += estimator.push_events(trial.events.between(start, arrival_us), arrival_us)
        start = arrival_us
        estimator.push_frame(image * np.uint16(64), mid_us)
    return rows


@pytest.fixture(scope='module')
def headed():
    found = random_model(CONFIG)
    found.tensors['frame.head.bias'][:] = 2.0  # frames show a contact
    for name in ('shear.unit', 'shear.deviation'):
        np.abs(found.tensors[name], out=found.tensors[name])
    return found


def test_the_normal_force_is_the_same_to_the_bit_with_and_without_the_head(headed, trial):
    kept = {name: each for name, each in headed.tensors.items() if not name.startswith('shear')}
    bare = replace(headed, config=FgerConfig().to_dict(), tensors=kept)
    with_head, without = run(headed, trial), run(bare, trial)
    assert [each[:3] for each in with_head] == [each[:3] for each in without]
    assert all(each.shear is None for each in without)
    assert all(np.isfinite(each.shear).all() for each in with_head)


def test_gains_of_weights_and_of_parameters_multiply_what_they_name(headed, trial):
    plain = np.array([each.shear for each in run(headed, trial)])
    assert np.abs(plain[:, :3]).max(axis=0).min() > 1e-6
    for found in (
        run(with_sideways_gain(with_gain(headed, 1.5), 2.0), trial),
        run(headed, trial, force_scale=1.5, sideways_scale=2.0),
    ):
        np.testing.assert_allclose([e.shear for e in found], 3.0 * plain, rtol=2e-3)


def test_impossible_gains_and_models_without_the_head_are_refused(headed, model):
    for gain in (0.0, float('nan')):
        with pytest.raises(ModelError):
            with_sideways_gain(headed, gain)
    with pytest.raises(ModelError):
        with_sideways_gain(model, 2.0)


class Message:
    """Takes any attribute."""


def test_quality_says_which_axes_are_known():
    for shear, known in ((Shear(0.1, 0.2, 3e-4, 0.05, 1e-4), True), (None, False)):
        message = Message()
        fill_quality(message, Estimate(2000, 0.5, shear=shear))
        assert message.sideways_known is message.torque_known is known
        assert (message.sideways_deviation > 0.0) is known
        assert (message.torque_deviation > 0.0) is known


def test_the_shipped_model_has_a_head_and_it_is_small():
    config = FgerConfig.from_dict(read_model(find_model('fger_small')).config)
    assert config.shear
    bare = replace(config, shear=False)
    assert count_parameters(config) - count_parameters(bare) < 5000
    assert operations_per_cycle(config) - operations_per_cycle(bare) < 2e5
