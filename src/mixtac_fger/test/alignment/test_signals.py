# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Smoothing keeps constants, times and peaks; the sign of a force."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixtac_fger.alignment.signals import (
    even_force,
    gaussian_smooth,
    pressing_sign,
    prominent_peaks,
    smooth_force,
)


@given(value=st.floats(-10, 10), number=st.integers(1, 60), width=st.floats(0.05, 30.0))
def test_a_constant_stays(value: float, number: int, width: float) -> None:
    smooth = gaussian_smooth(np.full(number, value), width)
    assert smooth == pytest.approx(np.full(number, value), abs=1e-9)


@given(values=st.lists(st.floats(-10, 10), min_size=1, max_size=80), width=st.floats(0.05, 30.0))
def test_smoothing_adds_no_delay(values: list[float], width: float) -> None:
    samples = np.array(values)
    forwards, backwards = gaussian_smooth(samples, width), gaussian_smooth(samples[::-1], width)
    assert forwards == pytest.approx(backwards[::-1], abs=1e-9)


def test_noise_goes_and_a_tap_stays() -> None:
    t = np.arange(0.0, 4.0, 1.25e-3)
    tap = 2.0 * np.exp(-0.5 * ((t - 2.0) / 0.006) ** 2)
    noisy = tap + np.random.default_rng(0).normal(0.0, 0.02, len(t))
    smooth = smooth_force(noisy, 1.25e-3)
    assert np.std((smooth - tap)[t < 1.8]) < 0.006
    assert smooth.max() == pytest.approx(2.0, abs=0.1)
    even, force = even_force(t, noisy)
    assert np.allclose(np.diff(even), 1.25e-3)
    assert even[np.argmax(force)] == pytest.approx(2.0, abs=2e-3)


def test_peaks_have_height_width_and_the_middle_of_their_plateau() -> None:
    values = np.array([0.0, 0.0, 1.0, 3.0, 3.0, 3.0, 1.0, 0.0, 0.4, 0.0, 0.0])
    ((place, prominence, width),) = prominent_peaks(values, 0.5, 9)
    assert (place, prominence) == (4, 3.0)
    assert width == pytest.approx(3.5)
    assert prominent_peaks(np.ones(20), 0.1, 5) == []


def test_pressing_is_positive_whatever_the_sign_of_the_sensor() -> None:
    force = np.array([0.1, 0.0, 0.1, 3.0, 0.1, -0.5])
    assert pressing_sign(force) == 1.0
    assert pressing_sign(-force) == -1.0
