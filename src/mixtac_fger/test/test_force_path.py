# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Sideways force and torsion by frames, events and gains."""

from __future__ import annotations

from dataclasses import asdict, replace
from types import SimpleNamespace

import numpy as np
import pytest
from toy_sensor import displacement, estimates, random_model

from mixtac_fger.config import MOMENTS, FgerConfig, ModelError
from mixtac_fger.estimator import Estimate, fill_quality
from mixtac_fger.features import bin_cells
from mixtac_fger.fger_net import with_gain
from mixtac_fger.force_path import ForcePath, Shear
from mixtac_fger.moments import PER_EVENT, moments
from mixtac_fger.weights import Model, ModelCard, read_model, save_model

CONFIG = FgerConfig(shear=True)
ROWS, COLUMNS = CONFIG.frame_shape
MIDDLE = 0.5 * (COLUMNS - 1), 0.5 * (ROWS - 1)
SPREAD = np.linspace(1.0, 3.0, MOMENTS).astype(np.float32)


@pytest.fixture(scope='module')
def headed():
    found = random_model(CONFIG)
    for name in ('shear.unit', 'shear.deviation'):
        np.abs(found.tensors[name], out=found.tensors[name])
    return found


@pytest.fixture
def path(headed):
    """Return a path that reads x and y from the moments of a pull, torque from one of turning."""
    constants = {
        'frame.spread': SPREAD,
        'shear.pull': np.float32([1.0, 0.0]),
        'shear.turning': np.float32([0.0, 0.5, 0.0, 0.0]),
        'shear.unit': np.array([2.0, 2.0, 3.0], np.float32),
        'shear.deviation': np.tile(np.float32([0.1, 0.2, 0.5]), (3, 1)),
    }
    return ForcePath(CONFIG, headed.tensors | constants)


def measured(path, flow):
    """Return what a frame with a displacement [2, rows, columns] in bins shows."""
    found = np.empty(MOMENTS, np.float32)
    moments(flow, found)
    return path.measure(found)


def load(pull=(0.0, 0.0), turn=0.0):
    """Return the displacement of a press in the middle, pulled and turned [bins]."""
    return displacement(MIDDLE, press=0.1, pull=pull, turn=turn, width=15.0)


def flow_between(before, after):
    """Return the event features of a motion that ideal pixels report in one window."""
    cells = np.zeros((CONFIG.grid_rows, CONFIG.grid_columns, 4), np.float32)
    (of_row, of_column), shape = bin_cells(CONFIG.frame_shape, CONFIG.grid_shape), cells.shape[:2]
    for row, column in np.ndindex(shape):
        inside = np.ix_([0, 1], of_row == row, of_column == column)
        mean = (after - before)[inside].mean(axis=(1, 2))
        cells[row, column, :2] = mean * CONFIG.frame_bin / PER_EVENT
    return cells


def test_events_show_what_the_next_frame_shows(path):
    before, after = load(), load(pull=(0.3, -0.2), turn=0.03)
    first, second = measured(path, before), measured(path, after)
    path.correct(first, 0)
    path.step(flow_between(before, after))
    change = (second.value - first.value)[1:]
    # The contact that moments are about is that of the frame before.
    np.testing.assert_allclose(path.moved[1:], change, rtol=0.2)
    assert (np.abs(change) > 0.05).all()


def test_a_frame_counts_from_the_centre_of_its_exposure_and_events_carry_it_on(path):
    assert not path.known
    start, pulled = load(), load(pull=(0.5, 0.0))
    shown = measured(path, start)
    path.correct(shown, 0)
    part = 0.25 * flow_between(start, pulled)
    step = np.tensordot(shown.per_flow, part[..., :2], 3)[1:]
    units = 2.0, 2.0, 3e-3
    for _ in range(4):
        path.step(part)
    expected = units * (shown.value[1:] + 4.0 * step)
    np.testing.assert_allclose(path.estimate()[0][1:], expected, rtol=1e-6)
    # Exposed two windows ago: only the last two increments come on top.
    shown = measured(path, load(pull=(0.4, 0.1)))
    path.correct(shown, 2)
    path.step(np.zeros_like(part))
    value = shown.value[1:] + 2.0 * step
    output, deviation = (each[1:] for each in path.estimate())
    np.testing.assert_allclose(output, units * value, rtol=1e-6)
    expected = units * np.sqrt(0.1**2 + (0.2 * value) ** 2 + (0.5 * 2.0 * np.abs(step)) ** 2)
    np.testing.assert_allclose(deviation, expected, rtol=1e-6)
    path.clear()
    assert not path.known


def test_the_output_follows_a_frame_over_some_windows_and_says_how_far_it_is(path):
    path.correct(measured(path, load()), 0)
    nothing = np.zeros((CONFIG.grid_rows, CONFIG.grid_columns, 4), np.float32)
    path.step(nothing)
    start = path.estimate()[0]
    shown = measured(path, load(pull=(0.5, 0.0)))
    path.correct(shown, 0, 10)
    assert path.estimate()[0] == pytest.approx(start)
    way = 2.0 * shown.value[1] - start[1]
    for left in range(9, -1, -1):
        before = path.estimate()[0]
        path.step(nothing)
        output, deviation = path.estimate()
        assert (output - before)[1] == pytest.approx(0.1 * way)
        assert deviation[1] > abs(0.1 * left * way)


def test_the_normal_force_is_the_same_with_and_without_the_others(headed, trial):
    kept = {name: each for name, each in headed.tensors.items() if not name.startswith('shear')}
    bare = replace(headed, config=asdict(FgerConfig()), tensors=kept)
    with_head, without = estimates(headed, trial), estimates(bare, trial)
    force, alone = (np.array([each[:3] for each in both]) for both in (with_head, without))
    np.testing.assert_allclose(force, alone, rtol=1e-9)
    assert all(each.shear is None for each in without)
    assert all(np.isfinite(each.shear).all() for each in with_head)


def test_gains_of_weights_and_of_parameters_multiply_what_they_name(headed, trial):
    plain = np.array([each.shear for each in estimates(headed, trial)])
    assert np.abs(plain[:, :3]).max(axis=0).min() > 1e-8
    for found in (
        estimates(with_gain(headed, 1.5, 2.0), trial),
        estimates(headed, trial, force_scale=1.5, sideways_scale=2.0),
    ):
        np.testing.assert_allclose([e.shear for e in found], 3.0 * plain, rtol=2e-3)


def test_impossible_gains_and_other_models_are_refused(model):
    other = Model('another', 1, model.config, model.card, model.tensors)
    for gain in (0.0, float('nan'), float('inf')):
        for gains in ((gain, 1.0), (1.0, gain)):
            with pytest.raises(ModelError):
                with_gain(model, *gains)
    with pytest.raises(ModelError):
        with_gain(other, 2.0)


def test_quality_says_which_axes_are_known():
    for shear, known in ((Shear(0.1, 0.2, 3e-4, 0.05, 1e-4), True), (None, False)):
        message = SimpleNamespace()
        fill_quality(message, Estimate(2000, 0.5, shear=shear))
        assert message.sideways_known is message.torque_known is known
        assert (message.sideways_deviation > 0.0) is known
        assert (message.torque_deviation > 0.0) is known


def forces(model, trial):
    """Return forces and deviations of a trial, [T, 2]."""
    return np.array([(each.force, each.deviation) for each in estimates(model, trial)])


@pytest.mark.parametrize('gain', [0.3, 1.0, 2.0])
def test_forces_are_multiplied_and_their_reasons_stay(model, trial, gain, monkeypatch):
    monkeypatch.setattr('mixtac_fger.streaming.LOWEST_FORCE', -0.01)
    monkeypatch.setattr('mixtac_fger.streaming.HIGHEST_FORCE', 0.01)
    before = {name: np.array(tensor) for name, tensor in model.tensors.items()}
    plain = forces(model, trial)
    assert len(plain) > 300
    assert np.abs(plain[:, 0]).max() > 0.01
    scaled = forces(with_gain(model, gain), trial)
    assert scaled == pytest.approx(gain * plain, rel=1e-4, abs=1e-5)
    for name, tensor in model.tensors.items():
        assert (tensor == before[name]).all()
    reasons = [
        [each.reason for each in estimates(m, trial)] for m in (model, with_gain(model, gain))
    ]
    assert reasons[0] == reasons[1]
    assert len(set(reasons[0])) > 1


def test_a_scaled_model_is_written_and_read_back(model, tmp_path):
    scaled = with_gain(model, 1.7)
    card = ModelCard({'calibrated': {'gain': 1.7, 'gel': 'soft'}}, {})
    path = tmp_path / 'mine.safetensors'
    save_model(
        path, Model(scaled.architecture, scaled.version, scaled.config, card, scaled.tensors)
    )
    found = read_model(path)
    assert found.card.training == card.training
    for name, tensor in scaled.tensors.items():
        assert (found.tensors[name] == tensor).all()
    assert 'soft' in path.with_suffix('.md').read_text()
