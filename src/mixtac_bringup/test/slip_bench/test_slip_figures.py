# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Figures, quantiles and the matching of slips with their onsets."""

import numpy as np
import pytest

from mixtac_bringup.slip_bench.dds_latency import _match
from mixtac_bringup.slip_bench.report import quantiles
from mixtac_bringup.slip_bench.slip_pattern import make_slip_pattern

MS = 1_000_000


def test_misses_are_later_than_everything() -> None:
    assert quantiles([1.0, 2.0, 3.0]) == {'p50': 2.0, 'p99': 3.0}
    assert quantiles([1.0, 2.0, float('nan')]) == {'p50': 2.0, 'p99': None}
    assert quantiles([]) == {'p50': None, 'p99': None}


def test_slips_are_matched_with_the_knocks_of_every_period() -> None:
    origin = 10**18
    scene = {'period_us': 1_000_000, 'onsets_us': [200_000, 700_000], 'speeds_mm_s': [30.0, 60.0]}
    # Period 0: both seen, 2 and 3 ms late; period 1: the first missed, a false one at 1.5 s.
    slips = [202, 703, 1500, 1704]
    sent = [205, 707, 1709]
    noted = {
        'slips_ns': [origin + at * MS for at in slips],
        'trajectories_ns': [origin + at * MS for at in sent],
    }
    found = _match(scene, noted, origin, (origin, origin + 2000 * MS), 0)
    assert found.speeds_mm_s == [30.0, 60.0, 30.0, 60.0]
    assert found.detection_ms == pytest.approx([2.0, 3.0, np.nan, 4.0], nan_ok=True)
    assert found.publish_ms == pytest.approx([5.0, 7.0, np.nan, 9.0], nan_ok=True)
    assert found.false_alarms == 1


def test_the_stream_holds_the_knocks_where_it_says() -> None:
    slips = make_slip_pattern(1.2, 1, preset_name='easy', quiet_s=0.3)
    pattern = slips.pattern
    assert len(slips.onsets_us) == 1
    assert pattern.period_us % 0x8000 == 0
    counts = np.bincount(pattern.events.t // 1000, minlength=pattern.period_us // 1000)
    onset = slips.onsets_us[0] // 1000
    assert counts[onset : onset + 4].max() > 3 * counts[onset - 200 : onset].max()
    assert pattern.frames >= 25
    assert len(pattern.words) == pattern.ends[-1]
