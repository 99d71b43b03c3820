# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Curves of the detectors against counting by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mixtac_lab.slip.detectors import ScoredTrial, detector_curve, score_trial
from mixtac_slip_control.errors import SlipControlError
from mixtac_slip_control.features import SlipWindow
from mixtac_slip_control.parameters import SlipControlParameters


def window(index: int, count: int, flow: tuple[float, float]) -> SlipWindow:
    return SlipWindow(1000 * (index + 1), count, *flow, 0.0, guided=True, complete=True)


def quiet_windows(number: int) -> list[SlipWindow]:
    rng = np.random.default_rng(0)
    counts, flows = rng.poisson(30.0, number), rng.normal(0.0, 0.002, (number, 2))
    rows = enumerate(zip(counts, flows, strict=True))
    return [window(i, int(n), (float(f[0]), float(f[1]))) for i, (n, f) in rows]


def trial(scores: list[float]) -> ScoredTrial:
    ends = 1000 * (1 + np.arange(len(scores), dtype=np.int64))
    values = np.array(scores)
    return ScoredTrial(ends, values, values)


def test_latency_alarms_and_misses_are_those_counted_by_hand() -> None:
    slips = [
        (trial([0.1] * 10 + [0.5, 2.0, 2.0]), 10_300),
        (trial([0.1] * 10 + [2.0, 2.0, 2.0]), 10_300),
        (trial([9.0] * 10 + [0.1, 0.1, 0.1]), 10_300),
    ]
    calm = trial([0.1] * 30_000)
    calm.count[[100, 102, 20_000]] = 1.5
    calm.count[5] = 0.9
    curve = detector_curve('count', slips, [calm], np.array([0.3, 1.0]))
    minutes = 29_999e-3 / 60.0
    assert curve['false_alarms_per_min'] == pytest.approx([3 / minutes, 2 / minutes], abs=1e-3)
    # One at the end of its first window, 0.7 ms after the onset, one a window later, one never.
    assert curve['latency_ms'] == pytest.approx([0.7, 1.7])
    assert curve['shipped']['latency_p99_ms'] is None
    assert curve['missed'] == pytest.approx([1 / 3, 1 / 3], abs=1e-4)


def test_the_area_is_that_of_all_pairs() -> None:
    rng = np.random.default_rng(4)
    slips = [(trial([0.0] * 5 + list(rng.normal(1.0, 1.0, 5))), 5000) for _ in range(40)]
    calm = [trial(list(rng.normal(0.0, 1.0, 203))) for _ in range(3)]
    slips[0][0].flow[:] = np.round(slips[0][0].flow)
    curve = detector_curve('flow', slips, calm)
    high = [max(t.flow[5:10]) for t, _ in slips]
    low = [max(t.flow[k : k + 5]) for t in calm for k in range(0, 200, 5)]
    pairs = [(a > b) + 0.5 * (a == b) for a in high for b in low]
    assert curve['auc'] == pytest.approx(np.mean(pairs), abs=1e-4)


def test_scores_are_one_at_the_threshold_of_each_detector() -> None:
    settings = SlipControlParameters(learning_time=0.2)
    windows = quiet_windows(260)
    windows += [window(260, 5000, (0.0, 0.0)), window(261, 30, (0.5, 0.0))]
    scored = score_trial(windows, 200, settings)
    assert len(scored.end_us) == 62
    assert scored.count[:60].max() < 1.0
    assert scored.flow[:60].max() < 1.0
    assert scored.count[60] > 1.0 > scored.flow[60]
    assert scored.flow[61] > 1.0 > scored.count[61]


def test_windows_that_a_lamp_hides_are_made_up_for() -> None:
    settings = SlipControlParameters(learning_time=0.2)
    windows = quiet_windows(400)
    for index in range(20, 120):
        windows[index] = replace(windows[index], light=True)
    scored = score_trial(windows, 210, settings)
    assert scored.end_us[0] == windows[300].end_us
    assert len(scored.end_us) == 100


def test_too_little_is_refused() -> None:
    with pytest.raises(SlipControlError):
        score_trial(quiet_windows(50), 20, SlipControlParameters())
    with pytest.raises(SlipControlError):
        detector_curve('flow', [], [])
    with pytest.raises(SlipControlError):
        detector_curve('other', [(trial([1.0]), 0)], [trial([1.0, 1.0])])
