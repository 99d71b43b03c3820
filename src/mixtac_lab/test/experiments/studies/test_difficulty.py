# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Figures of difficulty, on runs whose figures are known."""

from __future__ import annotations

import numpy as np
import pytest

from mixtac_lab.experiments.studies.difficulty import Judged, explained, sensor_scales, summarise
from mixtac_learning.judge.estimators import TrialEstimate

T_US = np.arange(0, 8_000_000, 2000)
TRUTH = (0.5 + 0.5 * np.sin(T_US / 4e5)).astype(np.float32)


def run(force, frames_only=TRUTH):
    force, frames_only = np.asarray(force, np.float64), np.asarray(frames_only, np.float64)
    return TrialEstimate('a', 'dynamic', '0', T_US, force, TRUTH, None, frames_only)


def test_each_estimator_gets_its_own_scale():
    fused, frames = sensor_scales(run(TRUTH / 2, TRUTH / 4))
    assert fused == pytest.approx(2.0)
    assert frames == pytest.approx(4.0)


def test_errors_ratio_and_drift():
    drifting = TRUTH + 0.1 * T_US / 1e6
    judged = Judged(
        run(TRUTH + 0.02, TRUTH - 0.06), run(drifting), TRUTH.astype(np.float64), np.ones(len(T_US))
    )
    figures = summarise([judged, judged])
    assert figures['fused_mae'] == pytest.approx(0.02, rel=1e-3)
    assert figures['frames_only_over_fused'] == pytest.approx(3.0, rel=1e-3)
    assert figures['events_only_drift'] == pytest.approx(0.1, rel=1e-3)
    assert figures['events_only_early_mae'] == pytest.approx(0.1, rel=0.01)
    assert figures['events_only_late_mae'] == pytest.approx(0.7, rel=0.01)
    assert figures['r2_brightness'] == pytest.approx(1.0)
    assert figures['r2_count'] == 0.0


def test_noise_explains_nothing_and_a_line_everything():
    rng = np.random.default_rng(3)
    assert explained(rng.normal(size=len(TRUTH)), TRUTH) < 0.01
    assert explained(3.0 - 2.0 * TRUTH, TRUTH) == pytest.approx(1.0)
