# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Impulses in each recording alone, and the vertex between samples."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixtac_fger.alignment.impulses import (
    Impulse,
    coincidences,
    find_force_impulses,
    prefer_isolated,
    pressing_sign,
    prominent_peaks,
    strongest,
    vertex,
)


@given(
    at=st.floats(-0.9, 0.9),
    curvature=st.floats(0.01, 1e6) | st.floats(-1e6, -0.01),
    n=st.integers(3, 40),
    start=st.floats(-1e4, 1e4),
)
def test_the_vertex_of_a_parabola_is_exact(
    at: float, curvature: float, n: int, start: float
) -> None:
    t = start + np.linspace(-1.0, 1.0, n)
    found = vertex(t, 3.0 + curvature * (t - start - at) ** 2)
    assert found == pytest.approx(start + at, abs=1e-5)


def test_only_the_strongest_of_neighbours_counts() -> None:
    impulses = [Impulse(t, s) for t, s in ((0.0, 1.0), (0.1, 3.0), (0.2, 2.0), (1.0, 1))]
    assert [i.time_s for i in strongest(impulses, 0.15)] == [0.1, 1.0]


@pytest.mark.parametrize('seed', range(4))
def test_force_peaks_lie_between_the_samples(scene: Any, seed: int) -> None:
    case = scene(seed=seed, noise=0.01, tap_s=0.016, drift=0.0, reference_start_s=0.0)
    _, t, force = case.recording()
    found = find_force_impulses(t, force)
    assert [i.time_s for i in found] == pytest.approx(case.taps_s, abs=3e-4)
    assert not any(i.saturated for i in found)


def test_slow_presses_are_no_impulses(scene: Any) -> None:
    _, t, force = scene(taps_s=(), heights=()).recording()
    assert find_force_impulses(t - t[0], force) == []


@pytest.mark.parametrize(
    ('taps', 'hold', 'wanted'),
    [
        ({1.0: 1.0, 5.0: 9.0, 5.2: 7.0, 5.37: 5.0, 5.5: 4.0, 10.0: 1.2}, 0.0, [1.0, 10.0]),
        ({1.0: 1.0, 6.0: 1.0, 10.0: 1.0}, 0.8, [1.0, 10.0]),
        ({1.0: 1.0, 1.2: 1.0, 5.0: 1.0, 5.2: 1.0}, 0.0, [1.0, 1.2, 5.0, 5.2]),
    ],
)
def test_taps_that_stand_alone_are_preferred(
    taps: dict[float, float], hold: float, wanted: list[float]
) -> None:
    time = np.arange(0.0, 12.0, 0.00125)
    height = sum(h * np.exp(-0.5 * ((time - at) / 0.008) ** 2) for at, h in taps.items())
    height = height + 0.01 * np.sin(700 * time) + hold * ((time > 4.0) & (time < 7.0))
    found = prefer_isolated([Impulse(at, 1.0) for at in taps], time, height)
    assert [each.time_s for each in found] == wanted


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


def test_weak_taps_that_agree_count_more_than_one_strong_pair() -> None:
    """Loads that fall are far stronger in the force than the taps, and make no burst."""
    camera, reference = np.array([9.0, 38.0]), np.array([12.8, 31.3, 31.6, 41.8])
    weight = np.outer([1.0, 0.8], [0.17, 1.0, 0.5, 0.19])
    found = coincidences(camera, reference, weight, tolerance_s=0.02, fewest=2)
    assert found == [(0, 0), (1, 3)]
