# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The learned tail against tails that are known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import genpareto

from mixtac_slip_control.background import Background, BackgroundSettings
from mixtac_slip_control.errors import SlipControlError


def learned(values: np.ndarray, settings: BackgroundSettings) -> Background:
    background = Background(settings, resolution=1e-6)
    for value in values[: settings.learning_windows]:
        assert not background.learned
        background.update(float(value))
    assert background.learned
    return background


@pytest.mark.parametrize('shape', [0.0, 0.1, 0.3])
def test_the_threshold_is_the_quantile_of_a_known_tail(shape: float) -> None:
    law = genpareto(shape, loc=30.0, scale=7.0)
    rng = np.random.default_rng(1)
    settings = BackgroundSettings(
        learning_windows=100_000, alarm_probability=1e-5, tail_shape=shape
    )
    background = learned(law.rvs(100_000, random_state=rng), settings)
    assert background.threshold == pytest.approx(law.isf(1e-5), rel=0.08)
    assert background.median == pytest.approx(law.median(), rel=0.02)


def test_a_normal_tail_is_not_underestimated() -> None:
    rng = np.random.default_rng(2)
    settings = BackgroundSettings(learning_windows=5000, alarm_probability=1e-5)
    background = learned(rng.normal(50.0, 5.0, 5000), settings)
    assert np.count_nonzero(rng.normal(50.0, 5.0, 400_000) > background.threshold) <= 4


def test_it_follows_a_slow_change_and_forgets_one_knock() -> None:
    rng = np.random.default_rng(3)
    settings = BackgroundSettings(learning_windows=1000, time_constant_windows=2000.0)
    background = learned(rng.poisson(30.0, 1000).astype(float), settings)
    before = background.threshold
    background.update(5000.0)
    assert background.threshold < 1.1 * before
    for value in rng.poisson(60.0, 20_000):
        background.update(float(value))
    assert background.median == pytest.approx(60.0, abs=4.0)
    assert background.begin == pytest.approx(np.quantile(rng.poisson(60.0, 50_000), 0.9), abs=4.0)
    assert background.threshold > before + 20.0


def test_a_constant_background_keeps_the_resolution() -> None:
    background = Background(BackgroundSettings(learning_windows=100), resolution=1.0)
    for _ in range(5000):
        background.update(12.0)
    assert background.scale == 1.0
    assert background.threshold > 12.0
    background.reset()
    assert not background.learned


@pytest.mark.parametrize(
    'bad',
    [
        {'learning_windows': 10},
        {'time_constant_windows': 1.0},
        {'alarm_probability': 0.0},
        {'alarm_probability': 0.5},
        {'tail_shape': 1.0},
        {'tail_shape': float('nan')},
    ],
)
def test_settings_without_a_meaning_are_refused(bad: dict[str, float]) -> None:
    with pytest.raises(SlipControlError, match='give'):
        BackgroundSettings(**bad)
