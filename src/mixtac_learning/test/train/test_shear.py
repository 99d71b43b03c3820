# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The head for sideways force: the fit finds what made the samples; a whole simulated trial."""

import numpy as np
import pytest

from mixtac_fger.config import FgerConfig
from mixtac_fger.fger_net import checked_config
from mixtac_fger.force_calibration import ForceCalibrationError
from mixtac_fger.shear import POWERS
from mixtac_fger.weights import find_model, read_model
from mixtac_learning.adapt.presses import fit_sideways, parse_load
from mixtac_learning.judge.metrics import CalibrationError, across_errors
from mixtac_learning.train.shear import HELD_OUT, ShearRecipe, ShearSample, fit_head, train_shear
from mixtac_learning.trials.simulated import SimulatedSource
from mixtac_sim.world.training_trials import TrialSpec

CONFIG = FgerConfig()


def sample(rng, weights, noise=0.0, count=400):
    shape = (count, CONFIG.grid_rows, CONFIG.grid_columns, 2)
    shown = rng.normal(0.0, 1.0, shape).astype(np.float32)
    force = rng.uniform(0.1, 1.0, count).astype(np.float32)
    wanted = shown.reshape(count, -1) @ weights.T * force[:, None] ** np.array(POWERS)
    wanted += noise * rng.normal(size=wanted.shape)
    flow, between = np.diff(shown, axis=0), force[1:]
    return ShearSample(shown, force, wanted.astype(np.float32), flow, between, np.ones(1))


def turned_alike():
    """Return weights of a law that has no favourite direction, falling off from the middle."""
    weights = np.zeros((3, CONFIG.grid_rows, CONFIG.grid_columns, 2))
    y, x = np.mgrid[-2.5:3.0, -3.5:4.0]
    bump = 0.04 - 0.009 * np.hypot(x, y)
    weights[0, ..., 0], weights[1, ..., 1] = bump, -bump
    weights[2, ..., 0], weights[2, ..., 1] = 0.3 * bump * y, -0.3 * bump * x
    return weights.reshape(3, -1)


def test_the_fit_finds_the_law_and_the_deviations():
    rng = np.random.default_rng(1)
    weights = turned_alike()
    clean = [sample(rng, weights) for _ in range(3)]
    found = fit_head(clean, [sample(rng, weights, noise=0.05)])
    np.testing.assert_allclose(found['shear.frame.weight'], weights, atol=0.08 * weights.max())
    assert found['shear.deviation'][:, 0] == pytest.approx(0.05, rel=0.25)


def test_pulls_along_x_teach_how_pulls_along_y_are_read():
    rng = np.random.default_rng(2)
    few = sample(rng, turned_alike())
    few.shown[..., 1] = few.flow[..., 1] = 0.0  # nothing moves along y
    few.wanted[:, 1] = 0.0
    few.wanted[:, 0] = 2.0 * few.shown[..., 2:4, 3:5, 0].mean((1, 2)) * few.force ** POWERS[0]
    x, y, _ = fit_head([few], [])['shear.frame.weight'].reshape(3, *CONFIG.grid_shape, 2)
    middle = slice(2, 4), slice(3, 5)
    assert x[(*middle, 0)].sum() > 0.2
    assert y[(*middle, 1)].sum() == pytest.approx(-x[(*middle, 0)].sum(), rel=1e-3)


def test_a_hanging_weight_gives_the_gain_whatever_pulled_before():
    since_s = np.arange(0.0, 10.0, 0.002)
    across = np.tile([0.05, -0.02, 0.0], (len(since_s), 1))
    across[(since_s > 3.0) & (since_s < 6.0), :2] += 0.1, 0.1
    found = fit_sideways(since_s, across, [parse_load('0.2:3-6')])
    assert found.gain == pytest.approx(0.2 / np.hypot(0.1, 0.1))
    assert 0.0 < found.gain_sd < 0.2 * found.gain
    assert found.turn is None
    with pytest.raises(ForceCalibrationError):  # nothing pulls there
        fit_sideways(since_s, across, [parse_load('0.2:7-9')])
    with pytest.raises(CalibrationError):
        fit_sideways(since_s, across, [parse_load('0.2:20-22')])


def test_errors_leave_out_what_is_unknown():
    known = np.array([[0.1, 0.2, 1e-3], [9.0, 9.0, 9.0]])
    found = np.array([[0.2, 0.2, 3e-3, 0.0, 0.0], [np.nan] * 5])
    assert across_errors(found, known) == pytest.approx((0.05, 0.15, 2.0, 1.0))


def test_a_head_is_trained_beside_a_model_whose_other_weights_stay(tmp_path):
    path = find_model('fger_small')
    spec = TrialSpec(700, 700, 'handling', 6.0)
    ShearRecipe(path).write(SimulatedSource(spec).load(), tmp_path / 'handling_1.npz')
    samples = [tmp_path / 'handling_1.npz']
    base = read_model(path)
    found = train_shear(base, samples, samples, {'data': 'simulated'})
    assert checked_config(found).shear
    errors = found.card.metrics[HELD_OUT]['handling']
    assert errors['sideways_mae_with_gain'] < 0.4 * errors['sideways_size']
    for name, tensor in base.tensors.items():
        if not name.startswith('shear.'):
            assert (found.tensors[name] == tensor).all()
