# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The rows of the study of sideways force: gains, cases by friction, errors by axis."""

from __future__ import annotations

import numpy as np
import pytest

from mixtac_lab.experiments.studies.contact import (
    FIRST_DEVICE,
    NEAR_MM,
    case_masks,
    near_seed,
    summarise,
)
from mixtac_learning.judge.estimators import TrialEstimate
from mixtac_sim.world.device import draw_conditions
from mixtac_sim.world.effects import preset
from mixtac_sim.world.training_trials import TRAINING_DEVICES, UNSEEN


def estimate(known, found):
    count = len(known)
    across = np.concatenate([found, np.zeros((count, 2))], axis=1)
    rows = np.arange(count), np.zeros(count), np.full(count, 0.5)
    return TrialEstimate('t', 'shear', 'd', *rows, None, across=across, known_across=known)


def test_windows_are_sorted_by_the_share_of_the_friction():
    each = estimate(np.zeros((4, 3)), np.zeros((4, 3)))
    masks = case_masks('handling', each, np.array([0.1, 0.5, 0.99, 0.29]))
    assert [mask.tolist() for mask in masks.values()] == [
        [True, False, False, True],
        [False, True, False, False],
        [False, False, True, False],
    ]
    assert list(case_masks('roll', each, np.zeros(4))) == ['roll']


def test_rows_hold_the_errors_of_each_axis():
    table = np.zeros((10, 15))
    table[:, 3:6], table[:, 6:9] = (0.2, 0.4, 2.0), (0.1, 0.1, 1.0)
    table[:, 9:12], table[:, 12:] = 0.5, 0.7
    rows = summarise([{'cases': {'stick': table}}])
    sideways, torsion = (next(r for r in rows if r['quantity'][:3] == q) for q in ('sid', 'tor'))
    assert (sideways['mae'], sideways['mae_uncalibrated']) == pytest.approx((0.1, 0.3))
    assert (sideways['mae_normal_gain'], sideways['mae_pulled_gain']) == pytest.approx((0.5, 0.7))
    assert (torsion['mae'], torsion['mae_uncalibrated']) == pytest.approx((1.0, 2.0))
    assert {row['case'] for row in rows} == {'stick', 'all'}


def test_contacts_are_near_the_axis_on_sensors_that_no_training_used():
    assert FIRST_DEVICE > UNSEEN > TRAINING_DEVICES
    seed = near_seed(5)
    assert np.hypot(*draw_conditions(seed, preset('paper_like')).contact_mm) <= NEAR_MM
