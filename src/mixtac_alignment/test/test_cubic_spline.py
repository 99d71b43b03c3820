# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The spline against SciPy's, and on a curve that it must follow."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline

from mixtac_alignment.gel_lag import spline_refined


@given(values=st.lists(st.floats(-10, 10), min_size=3, max_size=40), finer=st.integers(1, 6))
def test_it_is_the_natural_spline(values: list[float], finer: int) -> None:
    samples = np.array(values)
    places = np.arange((len(samples) - 1) * finer + 1) / finer
    wanted = CubicSpline(np.arange(len(samples)), samples, bc_type='natural')(places)
    assert spline_refined(samples, finer) == pytest.approx(wanted, abs=1e-9)


def test_two_samples_are_joined_by_a_line() -> None:
    assert spline_refined(np.array([1.0, 3.0]), 4) == pytest.approx(np.linspace(1.0, 3.0, 5))
