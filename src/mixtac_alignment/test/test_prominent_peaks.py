# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Peaks against SciPy's, on samples with plateaus and equal heights."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import find_peaks, peak_widths

from mixtac_alignment.signals import prominent_peaks

LEAST = 0.5


@given(
    values=st.lists(st.integers(0, 6), min_size=3, max_size=60),
    reach=st.integers(1, 20),
)
def test_places_prominences_and_widths_are_those_of_scipy(values: list[int], reach: int) -> None:
    samples, window = np.array(values, np.float64), 2 * reach + 1
    with warnings.catch_warnings():
        warnings.simplefilter('ignore')
        places, found = find_peaks(samples, prominence=LEAST, wlen=window)
        edges = (found['prominences'], found['left_bases'], found['right_bases'])
        widths = peak_widths(samples, places, 0.5, edges)[0]
    peaks = prominent_peaks(samples, LEAST, window)
    assert peaks.places.tolist() == places.tolist()
    assert peaks.prominences.tolist() == found['prominences'].tolist()
    assert peaks.widths == pytest.approx(widths)


def test_a_constant_has_no_peak() -> None:
    assert len(prominent_peaks(np.ones(20), 0.1, 5).places) == 0
