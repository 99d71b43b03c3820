# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Non-negative least squares against SciPy's, and by the conditions that any solution meets."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import nnls

from mixtac_alignment.taps import nonnegative_left, nonnegative_weights


@given(seed=st.integers(0, 2**32 - 1), columns=st.integers(1, 8), alike=st.booleans())
def test_what_is_left_is_what_scipy_leaves(seed: int, columns: int, alike: bool) -> None:
    rng = np.random.default_rng(seed)
    design = rng.normal(size=(60, columns))
    if alike:
        design = design[:, :1] + 0.05 * design
    signal = rng.normal(size=60) + design @ rng.normal(size=columns)
    weights, left = nnls(design, signal)
    assert nonnegative_left(design, signal) == pytest.approx(left**2, rel=1e-8)
    found = nonnegative_weights(design.T @ design, design.T @ signal)
    assert found == pytest.approx(weights, abs=1e-6 * (1.0 + float(weights.max())))


def test_a_signal_against_all_columns_is_left_whole() -> None:
    design = np.ones((5, 2))
    assert nonnegative_left(design, -np.ones(5)) == pytest.approx(5.0)
