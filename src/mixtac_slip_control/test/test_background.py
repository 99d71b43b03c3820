# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The background: learned robustly, followed slowly, never without a spread."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixtac_slip_control.background import Background, BackgroundSettings
from mixtac_slip_control.errors import SlipControlError


def fed(counts: np.ndarray, **settings: float) -> Background:
    background = Background(BackgroundSettings(**settings))
    for count in counts:
        background.update(int(count))
    return background


@pytest.mark.parametrize('mean', [0.05, 8.0, 34.0, 400.0])
def test_poisson_noise_is_learned(mean: float) -> None:
    background = fed(np.random.default_rng(3).poisson(mean, 20_000))
    assert background.learned
    assert background.mean == pytest.approx(mean, rel=0.05, abs=0.1)
    assert background.sigma == pytest.approx(max(1.0, math.sqrt(mean)), rel=0.1)


def test_knocks_while_learning_are_kept_out() -> None:
    rng = np.random.default_rng(4)
    counts = rng.poisson(30.0, 500)
    counts[100:150] = 3000
    background = fed(counts)
    assert background.mean == pytest.approx(30.0, abs=3.0)
    assert background.sigma < 10.0


def test_a_single_burst_moves_the_background_little() -> None:
    quiet = fed(np.full(600, 20))
    before = quiet.mean
    quiet.update(100_000)
    assert quiet.mean - before <= 3.0 * quiet.sigma / quiet.settings.time_constant_windows


def test_slow_changes_are_followed() -> None:
    rng = np.random.default_rng(5)
    background = fed(rng.poisson(np.linspace(30.0, 90.0, 30_000)), time_constant_windows=1000.0)
    assert background.mean == pytest.approx(88.0, abs=5.0)


@given(counts=st.lists(st.integers(0, 200_000), max_size=300), windows=st.integers(10, 50))
def test_it_is_a_number_for_any_counts(counts: list[int], windows: int) -> None:
    background = fed(np.array(counts, int), learning_windows=windows, time_constant_windows=1.0)
    assert background.learned == (len(counts) >= windows)
    assert math.isfinite(background.mean)
    assert 0.0 <= background.mean <= max([0, *counts])
    assert 1.0 <= background.sigma < math.inf


def test_reset_learns_anew() -> None:
    background = fed(np.full(600, 50))
    background.reset()
    assert (background.learned, background.mean, background.sigma) == (False, 0.0, 1.0)
    for _ in range(500):
        background.update(7)
    assert background.mean == 7.0


@pytest.mark.parametrize('settings', [{'learning_windows': 3}, {'time_constant_windows': 0.0}])
def test_settings_without_a_meaning_are_refused(settings: dict[str, float]) -> None:
    with pytest.raises(SlipControlError, match='at least'):
        BackgroundSettings(**settings)
