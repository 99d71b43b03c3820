# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Dominant frequencies, on signals whose frequency is known and on the simulated skin."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixtac_lab.experiments.paper import vibration
from mixtac_lab.experiments.paper.vibration import (
    COUNT,
    FLOW,
    PRESSED,
    TAPPING,
    shake,
    spectra,
    spectrum_of,
    tone_of,
)
from mixtac_recordings.recording import RecordingError


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


@pytest.mark.parametrize(
    ('name', 'hz'), [('speaker_120hz', 120.0), ('62.5Hz_b', 62.5), ('tone 90 Hz', 90.0)]
)
def test_tone_in_the_name_of_a_bag(name, hz):
    assert tone_of(name) == hz


def test_a_bag_that_does_not_say_its_tone_is_named():
    with pytest.raises(RecordingError) as refused:
        tone_of('speaker_a')
    assert 'speaker_a' in str(refused.value)
    assert refused.value.remedy


def shown(kind, size_mm):
    """Return the spectra of half a second at 70 Hz."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(vibration, 'SHAKEN_S', (0.65, 1.15))
        return spectra(shake(kind, 70.0, size_mm, 611))


def test_pressed_in_the_count_repeats_twice_per_period_and_flow_once():
    pressed = shown(PRESSED, 0.1)
    assert pressed[COUNT]['dominant_hz'] == pytest.approx(140.0, abs=1.0)
    assert pressed[FLOW]['dominant_hz'] == pytest.approx(70.0, abs=1.0)


def test_lost_contact_leaves_one_burst_per_period():
    assert shown(TAPPING, 0.6)[COUNT]['dominant_hz'] == pytest.approx(70.0, abs=1.0)
