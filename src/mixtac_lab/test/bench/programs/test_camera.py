# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The stream of knocks."""

import numpy as np

from mixtac_lab.bench.programs.camera import make_slip_pattern


def test_the_stream_holds_the_knocks_where_it_says() -> None:
    pattern, truth = make_slip_pattern(1.2, 1, preset_name='easy', quiet_s=0.3)
    assert len(truth['onsets_us']) == len(truth['speeds_mm_s']) == 1
    assert pattern.period_us % 0x8000 == 0
    counts = np.bincount(pattern.events.t // 1000, minlength=pattern.period_us // 1000)
    onset = truth['onsets_us'][0] // 1000
    assert counts[onset : onset + 4].max() > 2 * counts[onset - 200 : onset].max()
    assert pattern.frames >= 25
    assert len(pattern.words) == pattern.ends[-1]
