# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Sideways force and torsion: what frames show, what events add, gains; nothing else moves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from toy_sensor import random_model

from mixtac_fger.config import (
    ConfigError,
    FgerConfig,
    ModelError,
    count_parameters,
    operations_per_cycle,
)
from mixtac_fger.estimator import Estimate, fill_quality
from mixtac_fger.fger_net import FgerEstimator, with_gain, with_sideways_gain
from mixtac_fger.shear import Shear, ShearHead
from mixtac_fger.streaming import ForceEstimator
from mixtac_fger.weights import find_model, read_model

CONFIG = FgerConfig(shear=True)


def tensors():
    """Return a head that reads x and y from the first features of a frame, torque from a moment."""
    weight = np.zeros((2, CONFIG.feature_size), np.float32)
    gates = np.zeros((4, CONFIG.frame_size), np.float32)
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
    """Return the feature of a frame with a torque of (0.5 + x) moments."""
    feature = np.zeros(CONFIG.feature_size, np.float32)
    feature[:2] = x, y
    feature[-4:] = 0.0, moment, 0.0, moment
    return feature


def test_a_frame_counts_from_the_centre_of_its_exposure_and_events_carry_it_on():
    head = ShearHead(CONFIG, tensors())
    assert head.value is None
    head.correct(head.measure(shown(0.3, -0.2)), 0)
    for _ in range(4):
        head.step(np.float32([0.01, 0.0, 0.01]))
    assert head.value[:2] == pytest.approx((2.0 * 0.34, 2.0 * -0.2), rel=1e-5)
    # Exposed two windows ago: only the last two increments come on top.
    head.correct(head.measure(shown(0.5, 0.0, 0.6)), 2)
    assert head.value[:2] == pytest.approx((2.0 * 0.52, 0.0), rel=1e-5)
    assert head.value.torque == pytest.approx(3e-3 * 0.62, rel=1e-5)
    expected = 2.0 * np.sqrt(0.1**2 + (0.2 * 0.52) ** 2 + (0.5 * 0.02) ** 2)
    assert head.value.deviation == pytest.approx(expected, rel=1e-5)
    head.clear()
    assert head.value is None


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
