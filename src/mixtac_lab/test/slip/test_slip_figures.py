# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Quantiles with misses, the detectors' curves, and the stream of the benchmark over DDS."""

from pathlib import Path

import numpy as np
from matplotlib import image

from mixtac_lab.bench.programs.knock_camera import make_slip_pattern
from mixtac_lab.slip.trials import draw_curves, quantiles


def test_misses_are_later_than_everything() -> None:
    assert quantiles([1.0, 2.0, 3.0]) == {'p50': 2.0, 'p99': 3.0}
    assert quantiles([1.0, 2.0, float('nan')]) == {'p50': 2.0, 'p99': None}
    assert quantiles([]) == {'p50': None, 'p99': None}


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


def test_curves_are_drawn_where_a_detector_missed_everything(tmp_path: Path) -> None:
    curve = {
        'false_alarms_per_min': [3.0, 1.0, 0.0],
        'latency_ms': [0.8, 1.2, None],
        'shipped': {'latency_p50_ms': 1.2, 'false_alarms_per_min': 1.0},
    }
    missed = curve | {'shipped': {'latency_p50_ms': None, 'false_alarms_per_min': 0.0}}
    path = tmp_path / 'curves.png'
    draw_curves(path, {'10_mm_s': {'flow': curve, 'count': missed}})
    assert image.imread(path).std() > 0.05
