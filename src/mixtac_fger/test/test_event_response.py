# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Gain and play of the events of a sensor: recovered, bounded, and without a part in blows."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from toy_sensor import random_model

from mixtac_fger.config import CELL_FEATURES, FgerConfig
from mixtac_fger.recurrent_network import (
    FAST_INCREMENT,
    REVERSAL_N,
    EventResponse,
    RecurrentPath,
    advance,
    step_state,
    step_weights,
)


def after(changes, told, *, fast=0.0, turns=0.0, unit: float = 1.0) -> tuple[float, float]:
    """Return gain and play after frames between which the force changed and events told of it."""
    response = EventResponse(unit)
    same = np.broadcast_to(fast, len(changes)), np.broadcast_to(turns, len(changes))
    forces, *sums = np.cumsum(np.stack([changes, told, *same]), axis=1)
    for force, increments in zip(forces.tolist(), np.stack(sums, axis=1), strict=True):
        response.frame(force, increments)
    return response.values


@pytest.mark.parametrize('play', [0.0, 0.03, 0.08])
def test_the_play_of_a_sensor_is_found(play):
    """The play operator is the oracle; there is a frame every 20 windows, as in use."""
    true = 0.3 * np.sin(0.05 * np.arange(20000))
    told, direction = np.zeros((2, 20000))
    response = EventResponse()
    for index in range(1, 20000):
        told[index] = np.clip(told[index - 1], true[index] - play, true[index] + play)
        turn = (told[index] - told[index - 1]) / REVERSAL_N
        direction[index] = np.clip(direction[index - 1] + turn, -1.0, 1.0)
        if index % 20 == 0:
            response.frame(float(true[index]), np.array([told[index], 0.0, direction[index]]))
    gain, found = response.values
    # Less, because nothing is told while the play is crossed.
    assert 0.5 * play <= found <= play
    late = slice(10000, None)
    before = np.std((true - told)[late])
    assert np.std((true - gain * told - found * direction)[late]) <= 0.65 * before


def test_it_is_least_squares_with_a_prior():
    told, noise = np.random.default_rng(1).normal(0.0, 0.1, (2, 40))
    turns = np.random.default_rng(2).normal(0.0, 1.0, 40)
    changes = 0.7 * told + 0.05 * turns + 0.1 * noise
    # The first frame has none before it.
    weight = EventResponse.KEPT ** (0.5 * np.arange(39)[::-1])
    prior = np.diag([EventResponse.PRIOR_N, EventResponse.PRIOR_TURNS**0.5])
    rows = np.vstack([weight[:, None] * np.stack([told, turns], axis=1)[1:], prior])
    target = np.append(weight * changes[1:], [EventResponse.PRIOR_N, 0.0])
    expected = np.linalg.lstsq(rows, target, rcond=None)[0]
    assert after(changes, told, turns=turns) == pytest.approx(expected, rel=1e-9)


def test_events_that_contradict_count_as_little_as_possible():
    told, turns = np.random.default_rng(3).normal(0.0, (0.2, 1.0), (300, 2)).T
    assert after(-told, told)[0] == EventResponse.LOWEST
    assert after(9.0 * told, told)[0] == EventResponse.HIGHEST
    assert after(told - 0.2 * turns, told, turns=turns)[1] == 0.0
    assert after(told + 0.2 * turns, told, turns=turns)[1] == EventResponse.WIDEST_N


def test_blows_have_no_part():
    random = np.random.default_rng(4)
    told = random.normal(0.0, 0.1, 100)
    blow = np.where(np.arange(100) % 10 == 5, 5.0, 0.0)
    assert after(0.8 * told + blow, told, fast=blow) == pytest.approx(after(0.8 * told, told))
    gain, _ = after(0.8 * told + blow, told)
    assert gain == pytest.approx(after(0.8 * told, told)[0], abs=0.03)


@pytest.mark.parametrize('unit', [0.5, 3.0])
def test_a_blow_is_told_around_its_windows_and_motion_is_none(unit):
    config = FgerConfig(force_unit=unit)
    tensors = random_model(config).tensors
    tensors['increment.0.weight'][:, : config.lstm_size] = 0.0
    for layer in ('event.hidden', 'event.output', 'increment.0'):
        tensors[f'{layer}.bias'][:] = 0.0
    still = np.zeros((config.grid_rows, config.grid_columns, CELL_FEATURES), np.float32)
    burst = np.ones_like(still)
    per_burst = RecurrentPath(config, tensors).step(burst)

    def moved(forces: list[float]) -> RecurrentPath:
        scale = np.float32(unit / per_burst)
        weights = {**tensors, 'increment.2.weight': scale * tensors['increment.2.weight']}
        path = RecurrentPath(config, weights)
        for force in forces:
            # Increments are as large as their events, but for the square of what is fast.
            path.step(still if force == 0.0 else np.float32(force) * burst)
        return path

    quiet, half = [0.0] * 20, 3
    path = moved([*quiet, 1.5, *quiet])
    assert [lag for lag in range(40) if path.blow(lag, half)] == list(range(17, 24))
    assert not path.blow(500, half)
    assert path.mean(20, half) != path.mean(30, half)
    path = moved([*quiet, *[0.03] * 20])
    assert path.force > 0.4 * unit
    assert not any(path.blow(lag, half) for lag in range(40))
    assert not RecurrentPath(config, tensors).blow(0, half)


@given(
    gain=st.floats(0.5, 2.0),
    play=st.floats(0.0, 0.15),
    size=st.floats(0.01, 3000.0),
    seed=st.integers(0, 100),
)
@settings(max_examples=30)
def test_slow_increments_are_multiplied_and_fast_ones_are_not(model, gain, play, size, seed):
    config = FgerConfig.from_dict(model.config)
    weights = step_weights(model.tensors)
    state = step_state(weights)
    state.response[:2] = gain, play
    shape = (config.grid_rows, config.grid_columns, CELL_FEATURES)
    features = np.random.default_rng(seed).normal(0.0, size, shape).astype(np.float32)
    advance(features, weights, state)
    slow, fast, direction = state.increments
    expected = gain * slow + fast + play * direction
    assert state.force[0] == pytest.approx(expected, rel=1e-4, abs=1e-6)
    total = slow + fast
    assert slow == pytest.approx(total / (1.0 + (total / state.response[2]) ** 2), rel=1e-4)
    assert direction == pytest.approx(np.clip(slow / state.response[3], -1.0, 1.0), rel=1e-5)


def test_a_fast_change_is_unconfirmed_until_a_frame_has_seen_it(model):
    config = FgerConfig.from_dict(model.config)
    path = RecurrentPath(config, model.tensors)
    shape = (config.grid_rows, config.grid_columns, CELL_FEATURES)
    path.start_at(0.0)
    sums = [0.0]
    for _ in range(20):
        before = path.force
        path.step(np.full(shape, 500.0, np.float32))
        total = path.force - before
        sums.append(sums[-1] + total - total / (1.0 + (total / FAST_INCREMENT) ** 2))
    assert abs(sums[-1]) > 0.3
    assert path.unconfirmed == pytest.approx(sums[-1], rel=1e-4)
    for lag in (0, 5, 20):
        path.correct(np.zeros(config.feature_size, np.float32), lag)
        assert path.unconfirmed == pytest.approx(sums[-1] - sums[-1 - lag], rel=1e-4, abs=1e-6)
    path.clear()
    assert path.unconfirmed == 0.0
