# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The learned tail against tails that are known."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from scipy.stats import genpareto

from mixtac_slip_control.detectors import Background

from .slip_windows import parameters

if TYPE_CHECKING:
    from mixtac_slip_control.parameters import SlipControlParameters


def per_window(probability: float, windows: int, **changes: float) -> SlipControlParameters:
    """Parameters that learn from some windows, for a probability of an alarm in each."""
    rate = probability * 3600.0 / 1e-3
    return parameters(learning_time=1e-3 * windows, false_alarms_per_hour=rate, **changes)


def learned(values: np.ndarray, settings: SlipControlParameters) -> Background:
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
    settings = per_window(1e-4, 60_000, tail_shape=shape)
    background = learned(law.rvs(60_000, random_state=rng), settings)
    assert background.threshold == pytest.approx(law.isf(1e-4), rel=0.08)
    assert background.median == pytest.approx(law.median(), rel=0.02)


def test_a_normal_tail_is_not_underestimated() -> None:
    rng = np.random.default_rng(2)
    settings = per_window(1e-5, 5000)
    background = learned(rng.normal(50.0, 5.0, 5000), settings)
    assert np.count_nonzero(rng.normal(50.0, 5.0, 400_000) > background.threshold) <= 4


def test_it_follows_a_slow_change_and_forgets_one_knock() -> None:
    rng = np.random.default_rng(3)
    settings = per_window(1e-7, 1000, background_time_constant=2.0)
    background = learned(rng.poisson(30.0, 1000).astype(float), settings)
    before = background.threshold
    background.update(5000.0)
    assert background.threshold < 1.1 * before
    for value in rng.poisson(60.0, 20_000):
        background.update(float(value))
    assert background.median == pytest.approx(60.0, abs=4.0)
    assert background.start == pytest.approx(np.quantile(rng.poisson(60.0, 50_000), 0.9), abs=4.0)
    assert background.threshold > before + 20.0


def test_a_constant_background_keeps_the_resolution() -> None:
    background = Background(per_window(1e-7, 100), resolution=1.0)
    for _ in range(5000):
        background.update(12.0)
    assert background.scale == 1.0
    assert background.threshold > 12.0
    background.reset()
    assert not background.learned
