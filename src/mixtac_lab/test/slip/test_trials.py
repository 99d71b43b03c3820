# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Quantiles with misses, and objects that hardly hold."""

from __future__ import annotations

import numpy as np
import pytest

from mixtac_lab.slip.trials import AFTER_KNOCK_S, TrialPlan, latency_quantiles


def test_misses_are_later_than_everything() -> None:
    assert latency_quantiles([1.0, 2.0, 3.0]) == {'p50': 2.0, 'p99': 3.0}
    assert latency_quantiles([1.0, 2.0, float('nan')]) == {'p50': 2.0, 'p99': None}
    assert latency_quantiles([1.0, 2.0, None]) == {'p50': 2.0, 'p99': None}
    assert latency_quantiles([]) == {'p50': None, 'p99': None}


@pytest.mark.parametrize('wait_s', [0.0, 2.0])
def test_what_hardly_holds_an_object_holds_it_for_the_whole_trial(wait_s: float) -> None:
    # Three of these fall within 3.8 s if the smallest force is judged over the first 0.4 s alone.
    for seed in range(980_016, 980_020):
        plan = TrialPlan(seed=seed, margin=1.005, knock_mm_s=0.0, wait_s=wait_s)
        grasp = plan.grasp(camera=False)
        seconds = 1e-6 * plan.onset_us + AFTER_KNOCK_S
        block = grasp.advance(np.zeros(round(seconds / 125e-6)))
        assert block.object_mm[-1] < 0.1
