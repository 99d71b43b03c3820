# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The gain of the events of a sensor: recovered, bounded, and without a part in blows."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixtac_fger.config import CELL_FEATURES, FgerConfig
from mixtac_fger.recurrent_network import (
    EventGain,
    RecurrentPath,
    advance,
    step_state,
    step_weights,
)


def after(changes, told, *, fast=0.0, unit: float = 1.0) -> float:
    """Return the gain after frames between which the force changed and events told of it."""
    gain = EventGain(unit)
    sums = np.cumsum(np.stack([changes, told, np.broadcast_to(fast, len(changes))]), axis=1)
    for force, slow, quick in sums.T.tolist():
        gain.frame(force, slow, quick)
    return gain.value


@given(true=st.floats(0.5, 2.0), noise=st.floats(0.0, 0.01), seed=st.integers(0, 1000))
@settings(deadline=None, max_examples=40)
def test_the_gain_of_a_sensor_is_found(true, noise, seed):
    random = np.random.default_rng(seed)
    told = random.normal(0.0, 0.3, 300)
    changes = true * told + random.normal(0.0, noise, 300)
    assert after(changes, told) == pytest.approx(true, abs=0.1)


def test_it_is_least_squares_with_a_prior():
    random = np.random.default_rng(1)
    told, noise = random.normal(0.0, 0.1, (2, 40))
    changes = 0.7 * told + 0.1 * noise
    # The first frame has none before it.
    weight = EventGain.KEPT ** (0.5 * np.arange(39)[::-1])
    rows = np.append(weight * told[1:], EventGain.PRIOR_N)
    target = np.append(weight * changes[1:], EventGain.PRIOR_N)
    expected = np.linalg.lstsq(rows[:, None], target, rcond=None)[0][0]
    assert after(changes, told) == pytest.approx(expected, rel=1e-9)


def test_a_sensor_at_rest_keeps_its_gain():
    random = np.random.default_rng(2)
    assert after(*random.normal(0.0, 0.003, (2, 500))) == pytest.approx(1.0, abs=0.06)


def test_events_that_contradict_count_as_little_as_possible():
    told = np.random.default_rng(3).normal(0.0, 0.2, 300)
    assert after(-told, told) == EventGain.LOWEST
    assert after(9.0 * told, told) == EventGain.HIGHEST


def test_blows_have_no_part():
    random = np.random.default_rng(4)
    told = random.normal(0.0, 0.1, 100)
    blow = np.where(np.arange(100) % 10 == 5, 5.0, 0.0)
    assert after(0.8 * told + blow, told, fast=blow) == pytest.approx(after(0.8 * told, told))
    assert after(0.8 * told + blow, told) == pytest.approx(after(0.8 * told, told), abs=0.03)


@given(unit=st.floats(0.2, 5.0))
@settings(deadline=None, max_examples=20)
def test_the_unit_of_the_force_makes_no_difference(unit):
    told = np.random.default_rng(5).normal(0.0, 0.2, 50)
    plain = after(0.7 * told, told)
    assert after(unit * 0.7 * told, unit * told, unit=unit) == pytest.approx(plain)


def test_frames_before_a_hole_are_not_compared_with_those_behind_it():
    gain = EventGain()
    gain.frame(0.0, 0.0, 0.0)
    gain.forget_frame()
    gain.frame(0.5, 0.1, 0.0)
    assert gain.value == 1.0
    gain.frame(0.7, 0.2, 0.0)
    assert gain.value > 1.0


@given(gain=st.floats(0.5, 2.0), size=st.floats(0.01, 3000.0), seed=st.integers(0, 100))
@settings(deadline=None, max_examples=30)
def test_slow_increments_are_multiplied_and_fast_ones_are_not(model, gain, size, seed):
    config = FgerConfig.from_dict(model.config)
    weights = step_weights(model.tensors)
    state = step_state(weights)
    state.gain[0] = gain
    shape = (config.grid_rows, config.grid_columns, CELL_FEATURES)
    features = np.random.default_rng(seed).normal(0.0, size, shape).astype(np.float32)
    advance(features, weights, state)
    slow, fast = state.increments
    assert state.force[0] == pytest.approx(gain * slow + fast, rel=1e-4, abs=1e-6)
    total = slow + fast
    assert slow == pytest.approx(total / (1.0 + (total / state.gain[1]) ** 2), rel=1e-4)


def test_the_gain_outlives_a_restart_of_the_state(model):
    config = FgerConfig.from_dict(model.config)
    path = RecurrentPath(config, model.tensors)
    random = np.random.default_rng(6)
    shape = (config.grid_rows, config.grid_columns, CELL_FEATURES)
    path.start_at(0.0)
    for _ in range(40):
        for _ in range(20):
            path.step(random.normal(0.0, 3.0, shape).astype(np.float32))
        path.correct(random.normal(0.0, 3.0, config.frame_size).astype(np.float32), 10)
    learned = path.event_gain
    assert learned != 1.0
    path.clear()
    path.start_at(0.3)
    assert path.event_gain == learned
    assert path.force == pytest.approx(0.3)
