# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The smoothing against SciPy's."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter1d

from mixtac_alignment.signals import gaussian_smooth


@given(
    values=st.lists(st.floats(-10, 10), min_size=1, max_size=80),
    width=st.floats(0.05, 30.0),
)
def test_it_is_that_of_scipy_with_the_last_samples_going_on(
    values: list[float], width: float
) -> None:
    samples = np.array(values)
    wanted = gaussian_filter1d(samples, width, mode='nearest')
    assert gaussian_smooth(samples, width) == pytest.approx(wanted, abs=1e-9)
