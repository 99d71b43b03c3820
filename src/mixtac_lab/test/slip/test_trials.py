# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Quantiles with misses, and what trials at one margin or with a slow load come to."""

from __future__ import annotations

import numpy as np
import pytest

from mixtac_lab.slip.trials import AFTER_KNOCK_S, TrialPlan, latency_quantiles, load_row, margin_row


def test_misses_are_later_than_everything() -> None:
    assert latency_quantiles([1.0, 2.0, 3.0]) == {'p50': 2.0, 'p99': 3.0}
    assert latency_quantiles([1.0, 2.0, float('nan')]) == {'p50': 2.0, 'p99': None}
    assert latency_quantiles([1.0, 2.0, None]) == {'p50': 2.0, 'p99': None}
    assert latency_quantiles([]) == {'p50': None, 'p99': None}


def trial(*, held: bool, detection_ms: float | None, slip_mm: float) -> dict[str, object]:
    return {
        'held': held,
        'detection_ms': detection_ms,
        'slip_mm': slip_mm,
        'open_held': False,
        'open_slip_mm': 50.0,
        'peak_n': 1.0 + slip_mm,
        'stopped': '' if held else 'force',
        'slid_before': not held,
    }


def test_a_margin_counts_held_undetected_and_stops() -> None:
    row = margin_row(
        [
            trial(held=True, detection_ms=1.7, slip_mm=0.2),
            trial(held=True, detection_ms=2.7, slip_mm=0.4),
            trial(held=False, detection_ms=None, slip_mm=20.0),
            trial(held=True, detection_ms=1.7, slip_mm=0.6),
        ]
    )
    assert row['held'] == 0.75
    assert row['undetected'] == 0.25
    assert row['median_mm'] == 0.5
    assert row['open_held'] == 0.0
    assert row['peak_n'] == 21.0
    assert row['stopped'] == 1
    assert row['slid_before'] == 1
    assert row['trials'] == 4


def test_a_slow_load_counts_what_was_dropped() -> None:
    held = {'held': True, 'slip_mm': 0.1, 'slips': 1, 'grasp_n': 0.3, 'end_n': 0.6}
    lost = {'held': False, 'slip_mm': 90.0, 'slips': 2, 'grasp_n': 0.3, 'end_n': 0.3}
    both = [{**held, 'peak_n': 0.7, 'stopped': ''}, {**lost, 'peak_n': 0.4, 'stopped': 'no force'}]
    row = load_row([both[0], *both])
    assert (row['trials'], row['dropped'], row['slips'], row['stopped']) == (3, 1, 4, 1)
    assert (row['median_mm'], row['force_ratio'], row['peak_n']) == (0.1, 2.0, 0.7)


@pytest.mark.parametrize('wait_s', [0.0, 2.0])
def test_what_hardly_holds_an_object_holds_it_for_the_whole_trial(wait_s: float) -> None:
    # Three of these fall within 3.8 s if the smallest force is judged over the first 0.4 s alone.
    for seed in range(980_016, 980_020):
        plan = TrialPlan(seed=seed, margin=1.005, knock_mm_s=0.0, wait_s=wait_s)
        grasp = plan.grasp(camera=False)
        seconds = 1e-6 * plan.onset_us + AFTER_KNOCK_S
        block = grasp.advance(np.zeros(round(seconds / 125e-6)))
        assert block.object_mm[-1] < 0.1
