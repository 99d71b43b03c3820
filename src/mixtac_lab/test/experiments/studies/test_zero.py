# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The zero is read before contacts and after them, and synchronising impulses are none."""

from __future__ import annotations

import numpy as np
import pytest

from mixtac_lab.experiments.studies.zero import FIRST_DEVICE, WITHIN_N, summarise, zeros
from mixtac_learning.judge.estimators import TrialEstimate
from mixtac_sim.world.training_trials import TRAINING_DEVICES, UNSEEN


def estimate(offsets):
    """Return a trial of contacts of 1 s every 3 s, after each of which the zero has an offset."""
    t_us = np.arange(0, 3_000_000 * (len(offsets) + 1), 2000)
    known, force = np.zeros(len(t_us)), np.zeros(len(t_us))
    for index, offset in enumerate(offsets):
        begin = 3_000_000 * index + 1_500_000
        inside = (t_us >= begin) & (t_us < begin + 1_000_000)
        known[inside] = 0.5
        force[t_us >= begin] = offset
        force[inside] = 0.52
    impulse = t_us < 40_000
    known[impulse] = force[impulse] = 1.0
    return TrialEstimate('t', 'touch', 'd', t_us, force, known, None)


def test_zeros_are_read_around_each_contact():
    found = zeros(estimate([0.01, -0.03, 0.0]))
    assert found == pytest.approx(np.array([[0.0, 0.01], [0.01, -0.03], [-0.03, 0.0]]))
    row = summarise('press', found)
    assert (row['repetitions'], row['within']) == (3, 1)
    assert row['worst_n'] == pytest.approx(0.04)
    assert row['worst_zero_n'] == pytest.approx(0.03)
    assert row['median_n'] == pytest.approx(0.03)
    assert row['worst_n'] > WITHIN_N


def test_a_contact_whose_rest_is_cut_off_does_not_count():
    whole = estimate([0.01, 0.02])
    cut = whole.t_us < 5_500_000 + 1_000_000
    parts = (whole.t_us[cut], whole.force[cut], whole.known[cut])
    assert len(zeros(TrialEstimate('t', 'touch', 'd', *parts, None))) == 1


def test_the_sensors_are_none_of_training():
    assert FIRST_DEVICE > UNSEEN > TRAINING_DEVICES
