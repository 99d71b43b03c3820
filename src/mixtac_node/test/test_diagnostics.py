# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Rates and recent values."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixtac_node.diagnostics import RateMeter, RecentValues


def test_rate_is_counts_over_time():
    meter = RateMeter()
    assert meter.read(10.0) == 0.0
    meter.add(500)
    assert meter.read(11.0) == pytest.approx(500.0)
    meter.add()
    assert meter.read(13.0) == pytest.approx(0.5)
    assert meter.total == 501


def test_rate_survives_a_clock_that_stands_still():
    meter = RateMeter()
    meter.read(1.0)
    meter.add(5)
    assert meter.read(1.0) == 0.0


def test_no_values_have_no_quantile():
    assert math.isnan(RecentValues().quantile(0.5))


@given(
    st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=50),
    st.integers(1, 20),
    st.floats(0, 1),
)
def test_quantiles_are_those_of_the_latest_values(values: list[float], size: int, q: float):
    recent = RecentValues(size)
    for value in values:
        recent.add(value)
    kept = values[-size:]
    assert len(recent) == len(kept)
    assert recent.quantile(q) == pytest.approx(float(np.quantile(kept, q)))
