# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A force that vibrates is recognised, and its mean follows the frames."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixtac_fger.fger_net import Vibration

RATE_HZ = 500.0


def follow(force: np.ndarray, vibration: Vibration | None = None) -> np.ndarray:
    """Return in which windows a force vibrates."""
    vibration = vibration or Vibration(1.0)
    active = []
    for increment in np.diff(force, prepend=0.0).tolist():
        vibration.step(increment)
        active.append(vibration.active)
    return np.array(active)


def tone(frequency: float, amplitude: float, phase: float, windows: int = 300) -> np.ndarray:
    time = np.arange(windows) / RATE_HZ
    return amplitude * np.sin(2.0 * np.pi * (frequency * time + phase))


@given(
    frequency=st.floats(55.0, 230.0),
    amplitude=st.floats(0.05, 2.0),
    phase=st.floats(0.0, 1.0),
    slope=st.floats(-1.0, 1.0),
)
@settings(max_examples=60)
def test_a_tone_is_recognised_and_its_end_as_well(frequency, amplitude, phase, slope):
    force = tone(frequency, amplitude, phase)
    moved = force + slope * np.arange(len(force)) / RATE_HZ
    still = np.full(2 * Vibration.SPAN, moved[-1])
    active = follow(np.concatenate([moved, still]))
    np.testing.assert_array_equal(follow(5.0 * moved, Vibration(5.0)), active[: len(moved)])
    assert active[2 * Vibration.SPAN : len(moved)].all()
    assert not active[len(moved) + Vibration.SPAN :].any()


@given(
    seed=st.integers(0, 1000),
    noise=st.floats(0.0, 0.003),
    peak=st.floats(0.1, 10.0),
    width=st.integers(1, 8),
)
@settings(max_examples=40)
def test_noise_motion_and_a_blow_with_rebounds_are_no_vibration(seed, noise, peak, width):
    random = np.random.default_rng(seed)
    slow = 0.5 * np.sin(2.0 * np.pi * 8.0 * np.arange(300) / RATE_HZ)
    blow = np.zeros(300)
    for index in range(3):
        start = 60 + 4 * width * index
        blow[start : start + width] = peak * 0.5**index
    assert not follow(slow + blow + random.normal(0.0, noise, 300)).any()


def test_frames_lead_the_mean_there_and_the_misfit_tells_how_well():
    random = np.random.default_rng(4)
    vibration = Vibration(1.0)
    assert vibration.correct(0.8) == vibration.offset == 0.8
    assert vibration.misfit == 0.0
    misfits = []
    for difference in random.normal(0.5, 0.1, 300).tolist():
        before = vibration.offset
        misfits.append(vibration.misfit)
        assert vibration.correct(difference) == pytest.approx(vibration.offset - before)
    assert vibration.offset == pytest.approx(0.5, abs=0.15)
    assert np.median(misfits) == pytest.approx(0.1, rel=0.3)
    offset = vibration.offset
    assert vibration.end() == offset
    assert (vibration.offset, vibration.misfit) == (0.0, 0.0)
    assert vibration.correct(0.3) == 0.3


def test_the_deviation_is_at_least_its_mean_over_a_frame_interval():
    vibration = Vibration(1.0)
    given_n = np.tile([0.1, 0.9], 50)
    found = np.array([vibration.deviation(each) for each in given_n.tolist()])
    assert np.all(found >= given_n)
    assert found[-40:].min() == pytest.approx(0.5, abs=0.05)
    vibration.correct(0.0)
    vibration.correct(0.4)
    assert vibration.deviation(0.9) == pytest.approx(np.hypot(0.9, vibration.misfit))
