# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The gain of a sensor's events: found, bounded, and applied to what no frame has confirmed."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from toy_sensor import random_model

from mixtac_fger.config import CELL_FEATURES, FgerConfig
from mixtac_fger.recurrent_network import BLOW_N, EventGain, RecurrentPath


def gain_after(changes, added, unit: float = 1.0) -> float:
    """Return the gain after frames, of changes of the force and increments by events."""
    gain = EventGain(unit)
    for force, total in zip(np.cumsum(changes).tolist(), np.cumsum(added).tolist(), strict=True):
        gain.frame(force, total)
    return gain.value


@given(true=st.floats(-1.0, 6.0), seed=st.integers(0, 99), count=st.integers(2, 60))
@settings(max_examples=40)
def test_it_is_least_squares_with_a_prior(true, seed, count):
    """numpy's solution over all frames at once is the oracle."""
    random = np.random.default_rng(seed)
    added = random.uniform(-0.15, 0.15, count)
    changes = true * added + random.uniform(-0.02, 0.02, count)
    # The first frame has none before it.
    weight = EventGain.KEPT ** (0.5 * np.arange(count - 1)[::-1])
    prior = EventGain.PRIOR_N
    inputs, target = np.append(weight * added[1:], prior), np.append(weight * changes[1:], prior)
    (found,), *_ = np.linalg.lstsq(inputs[:, None], target, rcond=None)
    expected = np.clip(found, 0.0, EventGain.LARGEST)
    assert gain_after(changes, added) == pytest.approx(expected, abs=1e-9)


def test_events_that_explain_nothing_come_to_count_nothing():
    random = np.random.default_rng(3)
    added = random.normal(0.0, 0.2, 400)
    assert gain_after(np.zeros(4000), np.tile(added, 10)) < 0.05
    assert gain_after(-added, added) == 0.0
    assert gain_after(9.0 * added, added) == EventGain.LARGEST


def test_long_rest_and_blows_teach_nothing():
    random = np.random.default_rng(5)
    noise, added = random.normal(0.0, 0.002, (2, 20_000))
    assert gain_after(noise, added) == pytest.approx(1.0, abs=0.25)
    added = random.normal(0.0, 0.1, 100)
    blow = np.where(np.arange(100) % 10 == 5, 3.0, 0.0)
    sound = np.where(blow > 0.0, 0.0, added)
    assert gain_after(0.7 * added + blow, added + 3.0 * blow) == pytest.approx(
        gain_after(0.7 * sound, sound), abs=0.02
    )


@pytest.mark.parametrize('unit', [0.5, 3.0])
def test_the_unit_of_the_force_makes_no_difference(unit):
    added = np.random.default_rng(4).normal(0.0, 0.1, 50)
    assert gain_after(unit * 0.6 * added, unit * added, unit) == pytest.approx(
        gain_after(0.6 * added, added)
    )


def test_frames_before_a_hole_are_not_compared_with_those_behind_it():
    gain = EventGain()
    gain.frame(0.0, 0.0)
    gain.forget_frame()
    gain.frame(0.5, 0.1)
    assert gain.value == 1.0
    gain.frame(0.7, 0.2)
    assert gain.value > 1.0


def moving_path(unit: float, forces: list[float]) -> RecurrentPath:
    """Return a path whose increments were these [unit]: no memory, and events as large."""
    config = FgerConfig(force_unit=unit)
    tensors = random_model(config).tensors
    tensors['increment.0.weight'][:, : config.lstm_size] = 0.0
    for layer in ('event.hidden', 'event.output', 'increment.0'):
        tensors[f'{layer}.bias'][:] = 0.0
    burst = np.ones((config.grid_rows, config.grid_columns, CELL_FEATURES), np.float32)
    scale = np.float32(unit / RecurrentPath(config, tensors).step(burst))
    weights = {**tensors, 'increment.2.weight': scale * tensors['increment.2.weight']}
    path = RecurrentPath(config, weights)
    for force in forces:
        path.step(np.float32(force) * burst)
    return path


@pytest.mark.parametrize('unit', [0.5, 3.0])
def test_a_blow_is_found_around_its_windows_and_a_motion_is_none(unit):
    quiet, half = [0.0] * 20, 3
    path = moving_path(unit, [*quiet, 1.5 * BLOW_N, *quiet])
    assert [lag for lag in range(40) if path.blow(lag, half)] == list(range(17, 24))
    assert not path.blow(500, half)
    assert path.mean(20, half) != path.mean(30, half)
    path = moving_path(unit, [*quiet, *[0.05 * BLOW_N] * 20])
    assert path.force > 0.9 * unit * BLOW_N
    assert not any(path.blow(lag, half) for lag in range(40))


def test_a_change_is_multiplied_until_a_frame_has_confirmed_it():
    path = moving_path(1.0, [0.0] * 30)
    feature = np.zeros(FgerConfig().feature_size, np.float32)
    burst = np.ones((FgerConfig().grid_rows, FgerConfig().grid_columns, CELL_FEATURES), np.float32)
    # Frames that show more than the events do, again and again.
    for _ in range(40):
        for _ in range(20):
            path.step(np.float32(0.01) * burst)
        path.correct(feature, 10)
        assert path.moved == pytest.approx(0.1, rel=1e-3)
    assert path.force != path.network_force
    path.correct(feature, 0)
    assert path.moved == 0.0
    assert path.force == path.network_force


def test_the_gain_outlives_a_restart_of_the_state(model):
    config = FgerConfig.from_dict(model.config)
    path = RecurrentPath(config, model.tensors)
    random = np.random.default_rng(6)
    shape = (config.grid_rows, config.grid_columns, CELL_FEATURES)

    def ratio() -> float:
        path.start_at(0.3)
        assert path.force == pytest.approx(0.3)
        total = sum(path.step(random.normal(0.0, 3.0, shape).astype(np.float32)) for _ in range(5))
        return (path.force - path.network_force) / total + 1.0

    for _ in range(40):
        for _ in range(20):
            path.step(random.normal(0.0, 3.0, shape).astype(np.float32))
        path.correct(random.normal(0.0, 1.0, config.feature_size).astype(np.float32), 10)
    assert ratio() != pytest.approx(1.0)
    path.change_sensor()
    assert ratio() == pytest.approx(1.0)
