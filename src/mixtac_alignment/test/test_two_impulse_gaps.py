# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Missing data are found in both streams."""

from __future__ import annotations

import numpy as np
import pytest

from mixtac_alignment.errors import GapError
from mixtac_alignment.histories import EventCounts
from mixtac_alignment.two_impulse import mark_gaps, require_continuous


def test_silence_that_noise_makes_impossible_is_lost_data() -> None:
    counts = np.random.default_rng(0).poisson(10.0, 2000).astype(np.int64)
    counts[500:900] = 0
    marked = mark_gaps(EventCounts(0, 500, counts))
    assert marked.lost == ((500, 900),)
    assert marked.lost_near(910, 20)


def test_a_quiet_sensor_may_be_silent() -> None:
    counts = np.zeros(2000, np.int64)
    counts[::100] = 1
    assert mark_gaps(EventCounts(0, 500, counts)).lost == ()


def test_a_gap_in_the_force_is_refused() -> None:
    t = np.arange(0.0, 5.0, 1.0 / 800.0)
    require_continuous(t)
    require_continuous(np.delete(t, [100, 101]))
    with pytest.raises(GapError):
        require_continuous(np.where(t > 2.0, t + 0.2, t))
