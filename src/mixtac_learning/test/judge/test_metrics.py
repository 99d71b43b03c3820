# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Error figures on cases worked out by hand, and against torch-free definitions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixtac_learning.judge.metrics import (
    CalibrationError,
    fit_scale,
    frame_jump,
    hold_noise,
    lag_ms,
    measure,
)
from mixtac_learning.trials.trial import DatasetError


def test_figures_of_a_case_worked_out_by_hand():
    found = measure(np.array([0.0, 1.0, 2.0, 5.0]), np.array([0.0, 2.0, 2.0, 3.0]))
    assert found.mae == 0.75
    assert found.rmse == pytest.approx(np.sqrt(5 / 4))
    assert found.r2 == pytest.approx(1 - 5 / 14)
    assert found.constant_mae == 1.5
    assert (found.peak_truth, found.peak_estimate, found.samples) == (5.0, 3.0, 4)


def test_a_constant_truth_has_no_r2_and_json_leaves_it_out():
    found = measure(np.ones(3), np.zeros(3))
    assert np.isnan(found.r2)
    assert 'r2' not in found.to_dict()


def test_the_best_constant_has_the_constant_figure():
    truth = np.random.default_rng(0).exponential(1.0, 101)
    found = measure(truth, np.full(101, np.median(truth)))
    assert found.mae == pytest.approx(found.constant_mae)


@pytest.mark.parametrize(('truth', 'estimate'), [([], []), ([1.0], [1.0, 2.0])])
def test_arrays_that_cannot_be_compared_are_refused(truth, estimate):
    with pytest.raises(DatasetError):
        measure(np.array(truth), np.array(estimate))


INTERVAL_S = 0.002


def test_steps_at_frames_are_told_from_motion():
    corrected = np.arange(200) % 20 == 0
    motion = 0.001 * np.arange(200)
    assert frame_jump(motion, corrected) == pytest.approx(1.0)
    assert frame_jump(motion + 0.004 * np.cumsum(corrected), corrected) == pytest.approx(5.0)
    assert np.isnan(frame_jump(motion, np.zeros(200, np.bool_)))
    assert np.isnan(frame_jump(np.cumsum(corrected) + 1e-9 * motion, corrected))


def test_noise_of_a_hold_is_that_without_drift_and_without_the_way_there():
    rng = np.random.default_rng(1)
    known = np.interp(np.arange(6000), [0, 1000, 1500], [0.0, 0.0, 1.0])
    noise = rng.normal(0.0, 0.02, 6000)
    drift = 0.1 * np.sin(2.0 * np.pi * np.arange(6000) * INTERVAL_S / 12.0)
    bad = np.where(known < 1.0, 10.0 * noise, noise)
    assert hold_noise(known, known + bad + drift, INTERVAL_S) == pytest.approx(0.02, rel=0.1)
    assert np.isnan(hold_noise(np.zeros(6000), noise, INTERVAL_S))


@pytest.mark.parametrize('late', [-6.0, 0.0, 3.0, 7.0])
def test_lag_is_found_between_samples(late):
    t_ms = 2.0 * np.arange(3000)
    known, estimate = (1.0 + np.sin(2.0 * np.pi * (t_ms - d) / 97.0) for d in (0.0, late))
    assert lag_ms(known, estimate, INTERVAL_S) == pytest.approx(late, abs=0.1)
    assert np.isnan(lag_ms(np.ones(3000), estimate, INTERVAL_S))


@given(st.floats(0.3, 3.0), st.integers(0, 100))
def test_the_scale_is_found_despite_noise_and_a_lost_stretch(scale, seed):
    random = np.random.default_rng(seed)
    truth = np.abs(np.sin(np.linspace(0, 9, 2000)))
    estimate = truth / scale + random.normal(0, 0.01, truth.size)
    estimate[500:550] *= 3.0
    assert fit_scale(estimate, truth) == pytest.approx(scale, rel=0.03)


def test_the_scale_makes_the_mean_absolute_error_smallest():
    random = np.random.default_rng(1)
    truth = random.uniform(0.2, 1.0, 500)
    estimate = truth * random.uniform(0.5, 1.5, 500)
    found = fit_scale(estimate, truth)
    smallest = np.mean(np.abs(found * estimate - truth))
    for other in (0.97, 1.0 / found, 1.03):
        assert np.mean(np.abs(other * found * estimate - truth)) >= smallest


@pytest.mark.parametrize('force', [0.05, 0.0])
def test_forces_that_are_too_small_are_refused(force):
    with pytest.raises(CalibrationError):
        fit_scale(np.full(500, 1.0), np.full(500, force))
