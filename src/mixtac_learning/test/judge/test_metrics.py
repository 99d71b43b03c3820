# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Error figures on cases worked out by hand, and against torch-free definitions."""

from __future__ import annotations

import numpy as np
import pytest

from mixtac_learning.judge.metrics import measure
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
