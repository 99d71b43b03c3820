# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Pooling over recordings of one sensor, against the conjugate normal formulas by hand."""

from __future__ import annotations

import numpy as np
import pytest

from mixtac_alignment.bags import pool_lag, pool_latency
from mixtac_alignment.clock_fit import Anchor, ClockFit
from mixtac_alignment.gel_lag import GelLag
from mixtac_alignment.parameters import AlignmentParameters
from mixtac_alignment.refinement import Refinement

PRIOR = GelLag((0.2,) * 6, (0.1,) * 6)


def refinement(
    weight: float, std: float, late_s: float = 0.0, map_std_s: float = 1e-4
) -> Refinement:
    """Return a refinement whose weights were measured with a standard deviation, by one prior."""
    posterior = 1.0 / (1.0 / std**2 + 1.0 / 0.1**2)
    mean = posterior * (weight / std**2 + 0.2 / 0.1**2)
    anchors = tuple(Anchor(t, t * 1e-6, 1e-4) for t in (1_000_000, 9_000_000))
    fit = ClockFit(
        1.0, 0.0, np.diag([0.0, map_std_s**2]), 5_000_000, 5.0, anchors, np.full(2, -late_s), 'x'
    )
    return Refinement(fit, GelLag((mean,) * 6, (0.1,) * 6), posterior * np.eye(6))


def test_pooled_weights_are_those_of_all_measurements_and_one_prior() -> None:
    measured = [(0.3, 0.05), (0.1, 0.2), (0.25, 0.02)]
    pooled = pool_lag([refinement(*each) for each in measured], PRIOR)
    precision = 1.0 / 0.1**2 + sum(1.0 / std**2 for _, std in measured)
    mean = (0.2 / 0.1**2 + sum(w / std**2 for w, std in measured)) / precision
    assert pooled.mean == pytest.approx((mean,) * 6, rel=1e-6)
    assert pooled.std == pytest.approx((precision**-0.5,) * 6, rel=1e-6)


def test_recordings_that_show_nothing_leave_the_prior() -> None:
    pooled = pool_lag([refinement(0.9, 1e6), refinement(-0.4, 1e6)], PRIOR)
    assert pooled.mean == pytest.approx(PRIOR.mean, abs=1e-6)
    assert pooled.std == pytest.approx(PRIOR.std, abs=1e-6)


def test_latency_moves_by_what_the_taps_show_late() -> None:
    before = AlignmentParameters(tap_latency=1.0, tap_latency_std=1.0)
    after = pool_latency([refinement(0.2, 0.1, late_s=0.8e-3) for _ in range(20)], before)
    assert after.tap_latency_s == pytest.approx(1.8e-3, abs=5e-5)
    assert 1e-4 < after.tap_latency_std_s < 3e-4
    assert pool_latency([], before).tap_latency_s == 1.0e-3
