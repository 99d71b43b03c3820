# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Figures of errors on signals whose answers are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixtac_fger.validity import Reason
from mixtac_learning.judge.estimators import TrialEstimate
from mixtac_learning.judge.metrics import (
    by_profile,
    fit_scale,
    measure,
    peak_error,
    summarise,
    trial_row,
)
from mixtac_learning.judge.report import show_figures
from mixtac_learning.trials.trial import DatasetError

STEP_S = 0.002


def estimate(known, force, profile='press', device='a', **rest) -> TrialEstimate:
    t_us = np.arange(len(known), dtype=np.int64) * 2000
    return TrialEstimate('t', profile, device, t_us, force, known, **rest)


def test_peaks_may_be_a_little_early():
    known, late = np.zeros(500), np.zeros(500)
    known[200:203], late[204:206] = 8.0, 6.0
    assert peak_error(known, late, STEP_S) == pytest.approx(0.25)
    far = np.zeros(500)
    far[300] = 8.0
    assert peak_error(known, far, STEP_S) == pytest.approx(1.0)
    assert np.isnan(peak_error(np.zeros(5), np.ones(5), STEP_S))


def test_profiles_are_kept_apart_and_pooled():
    known = np.linspace(0, 1, 100)
    rows = by_profile(
        [
            estimate(known, known + 0.1, 'press', 'a'),
            estimate(known, 0.5 * known, 'static', 'b'),
        ],
        {'b': 2.0},
    )
    assert list(rows) == ['press', 'static', 'all']
    assert rows['press']['mae'] == pytest.approx(0.1)
    assert rows['static']['calibrated_mae'] == pytest.approx(0.0)
    assert rows['all']['mae'] == pytest.approx((0.1 + 0.25) / 2, abs=1e-3)
    assert rows['all']['trials'] == 2
    assert 'calibrated_mae' not in summarise([estimate(known, known)])


def test_coverage_counts_windows():
    known, wide = np.zeros(1000), np.ones(1000)
    each = estimate(known, np.linspace(0, 3, 1000), deviation=wide)
    figures = summarise([each])
    assert figures['coverage_68'] == pytest.approx(1 / 3, abs=0.01)
    assert figures['coverage_95'] == pytest.approx(1.96 / 3, abs=0.01)
    assert figures['mean_deviation'] == 1.0
    assert 'coverage_68' not in summarise([each, replace(each, deviation=None)])


def test_a_row_of_a_bag_worked_out_by_hand():
    """A hold of 1 N; the estimate is 10 % too small, and near zero for 0.1 s and for 20 ms."""
    known = np.r_[np.zeros(500), np.ones(500)]
    force = 0.9 * known
    force[700:750] = force[900:910] = 0.2
    reasons = np.full(1000, int(Reason.TRUSTED))
    reasons[:100] = reasons[700:710] = int(Reason.STALE)
    row = trial_row(
        estimate(known, force, frames_only=known - 0.02, deviation=0.1 * known, reasons=reasons)
    )
    assert row['bag'] == 't'
    assert row['mae_n'] == pytest.approx((440 * 0.1 + 60 * 0.8) / 1000)
    assert row['rmse_n'] == pytest.approx(np.sqrt((440 * 0.01 + 60 * 0.64) / 1000), abs=1e-4)
    assert row['mae_best_gain_n'] == pytest.approx(60 * (1 - 0.2 / 0.9) / 1000, abs=1e-4)
    # All at the best gain, 1 / 0.9.
    held = (500 * 0.02 / 0.9 + 500 * (0.98 / 0.9 - 1)) / 1000
    assert row['frames_held_mae_n'] == pytest.approx(held, abs=1e-4)
    # 20 ms before and after the step are not slow.
    assert row['slow_mae_n'] == pytest.approx(60 * (1 - 0.2 / 0.9) / 980, abs=1e-4)
    assert row['coverage_68'] == row['coverage_95'] == pytest.approx(0.94)
    assert row['falsely_invalid'] == pytest.approx(0.1)
    assert row['collapses'] == 1
    bare = trial_row(estimate(known, force))
    assert bare['frames_held_mae_n'] is bare['coverage_95'] is bare['falsely_invalid'] is None


def test_figures_are_shown_by_profile(capsys):
    rows = {'press': {'mae': 0.1234, 'rmse': 0.2}, 'all': {'mae': 0.3}}
    show_figures('trials', rows)
    text = capsys.readouterr().out
    assert all(each in text for each in ('press', 'all', '0.123', '0.200', '0.300'))
    assert 'r2' not in text


def test_figures_of_a_case_worked_out_by_hand():
    found = measure(np.array([0.0, 1.0, 2.0, 5.0]), np.array([0.0, 2.0, 2.0, 3.0]))
    assert found['mae'] == 0.75
    assert found['rmse'] == pytest.approx(np.sqrt(5 / 4))
    assert found['r2'] == pytest.approx(1 - 5 / 14)
    assert found['constant_mae'] == 1.5
    assert (found['peak_truth'], found['samples']) == (5.0, 4)
    assert 'r2' not in measure(np.ones(3), np.zeros(3))


@given(st.floats(0.3, 3.0), st.integers(0, 100))
def test_the_scale_is_found_despite_noise_and_a_lost_stretch(scale, seed):
    random = np.random.default_rng(seed)
    truth = np.abs(np.sin(np.linspace(0, 9, 2000)))
    estimate = truth / scale + random.normal(0, 0.01, truth.size)
    estimate[500:550] *= 3.0
    assert fit_scale(estimate, truth) == pytest.approx(scale, rel=0.03)


@pytest.mark.parametrize('force', [0.05, 0.0])
def test_forces_that_are_too_small_are_refused(force):
    with pytest.raises(DatasetError):
        fit_scale(np.full(500, 1.0), np.full(500, force))
