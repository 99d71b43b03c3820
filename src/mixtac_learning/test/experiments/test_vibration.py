# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Dominant frequencies, on signals whose frequency is known and on the simulated skin."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixtac_learning.experiments import vibration
from mixtac_learning.experiments.vibration import (
    COUNT,
    FLOW,
    PRESSED,
    TAPPING,
    shake,
    spectra,
    spectrum_of,
)


@settings(max_examples=60)
@given(st.floats(35.0, 490.0), st.floats(0.0, 6.28), st.integers(0, 100))
def test_frequency_of_a_noisy_tone(hz, phase, seed):
    t_s = 1e-3 * np.arange(1000)
    noise = np.random.default_rng(seed).normal(0.0, 0.3, 1000)
    found = spectrum_of(5.0 + np.sin(2.0 * np.pi * hz * t_s + phase) + noise, 1000)
    assert found['dominant_hz'] == pytest.approx(hz, abs=0.5)
    assert len(found['spectrum']) == 501
    assert max(found['spectrum']) == 1.0
    assert abs(int(np.argmax(found['spectrum'])) - hz) <= 1.0


def test_slow_relaxation_is_not_taken_for_a_tone():
    t_s = 2e-3 * np.arange(500)
    signal = 50.0 * np.exp(-3.0 * t_s) + np.sin(2.0 * np.pi * 90.0 * t_s)
    assert spectrum_of(signal, 2000)['dominant_hz'] == pytest.approx(90.0, abs=0.5)


def shown(kind, size_mm):
    """Return the spectra of half a second at 70 Hz."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(vibration, 'SHAKEN_S', (0.65, 1.15))
        return spectra(*shake(kind, size_mm, 70.0, 611))


def test_pressed_in_the_count_repeats_twice_per_period_and_flow_once():
    pressed = shown(PRESSED, 0.1)
    assert pressed[COUNT]['dominant_hz'] == pytest.approx(140.0, abs=1.0)
    assert pressed[FLOW]['dominant_hz'] == pytest.approx(70.0, abs=1.0)


def test_lost_contact_leaves_one_burst_per_period():
    assert shown(TAPPING, 0.6)[COUNT]['dominant_hz'] == pytest.approx(70.0, abs=1.0)
