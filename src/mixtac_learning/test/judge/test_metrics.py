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
    measure,
)
from mixtac_learning.trials.trial import DatasetError


def test_figures_of_a_case_worked_out_by_hand():
    found = measure(np.array([0.0, 1.0, 2.0, 5.0]), np.array([0.0, 2.0, 2.0, 3.0]))
    assert found['mae'] == 0.75
    assert found['rmse'] == pytest.approx(np.sqrt(5 / 4))
    assert found['r2'] == pytest.approx(1 - 5 / 14)
    assert found['constant_mae'] == 1.5
    assert (found['peak_truth'], found['peak_estimate'], found['samples']) == (5.0, 3.0, 4)


def test_a_constant_truth_has_no_r2():
    assert 'r2' not in measure(np.ones(3), np.zeros(3))


def test_the_best_constant_has_the_constant_figure():
    truth = np.random.default_rng(0).exponential(1.0, 101)
    found = measure(truth, np.full(101, np.median(truth)))
    assert found['mae'] == pytest.approx(found['constant_mae'])


@pytest.mark.parametrize(('truth', 'estimate'), [([], []), ([1.0], [1.0, 2.0])])
def test_arrays_that_cannot_be_compared_are_refused(truth, estimate):
    with pytest.raises(DatasetError):
        measure(np.array(truth), np.array(estimate))


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
