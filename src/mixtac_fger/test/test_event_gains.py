# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The gains of a sensor's events: found, bounded, and applied to what no frame has confirmed."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from toy_sensor import random_model

from mixtac_fger.config import CELL_FEATURES, MOMENTS, FgerConfig
from mixtac_fger.force_path import BLOW_N, EventGains, ForcePath, Shown

CONFIG = FgerConfig()
BURST = np.ones((*CONFIG.grid_shape, CELL_FEATURES), np.float32)
STILL = np.zeros((1, *CONFIG.grid_shape, 2))


def shown(force: float, press: np.ndarray = STILL) -> Shown:
    """Return what a frame without moments shows."""
    return Shown(np.zeros(MOMENTS, np.float32), np.array([force]), press)


def gains_after(changes, added, unit: float = 1.0) -> np.ndarray:
    """Return the gains after frames, of changes of the force and of A and B, [frames, 2]."""
    gains = EventGains(unit)
    for force, sums in zip(np.cumsum(changes).tolist(), np.cumsum(added, axis=0), strict=True):
        gains.frame(force, sums)
    return gains.value


@given(
    true=st.tuples(st.floats(-1.0, 6.0), st.floats(-1.0, 3.0)),
    alike=st.floats(0.0, 1.0),
    seed=st.integers(0, 99),
    count=st.integers(2, 60),
)
@settings(max_examples=40)
def test_they_are_least_squares_with_a_prior(true, alike, seed, count):
    """numpy's solution over all frames at once is the oracle."""
    random = np.random.default_rng(seed)
    added = random.uniform(-0.05, 0.05, (count, 2))
    added[:, 1] += alike * added[:, 0]
    changes = added @ true + random.uniform(-0.02, 0.02, count)
    # The first frame has none before it.
    weight = EventGains.KEPT ** (0.5 * np.arange(count - 1)[::-1])
    prior = EventGains.PRIOR_N * np.eye(2)
    inputs = np.vstack([weight[:, None] * added[1:], prior])
    target = np.append(weight * changes[1:], prior @ EventGains.PRIOR)
    found, *_ = np.linalg.lstsq(inputs, target, rcond=None)
    expected = np.clip(found, 0.0, EventGains.LARGEST)
    assert gains_after(changes, added) == pytest.approx(expected, abs=1e-9)


def test_events_that_explain_nothing_come_to_count_nothing():
    added = np.random.default_rng(3).normal(0.0, 0.2, (400, 2))
    assert (gains_after(np.zeros(4000), np.tile(added, (10, 1))) < 0.05).all()
    assert (gains_after(-added.sum(1), added) == 0.0).all()
    assert gains_after(9.0 * added[:, 0], added)[0] == EventGains.LARGEST


def test_long_rest_and_blows_teach_nothing():
    random = np.random.default_rng(5)
    noise, added = random.normal(0.0, 0.002, 20_000), random.normal(0.0, 0.002, (20_000, 2))
    assert gains_after(noise, added) == pytest.approx(np.array(EventGains.PRIOR), abs=0.15)
    added = random.normal(0.0, 0.1, (100, 2))
    blow = np.where(np.arange(100) % 10 == 5, 3.0, 0.0)
    sound = np.where(blow > 0.0, 0.0, added.T).T
    assert gains_after(0.7 * added[:, 0] + blow, added + 3.0 * blow[:, None]) == pytest.approx(
        gains_after(0.7 * sound[:, 0], sound), abs=0.02
    )


@pytest.mark.parametrize('unit', [0.5, 3.0])
def test_the_unit_of_the_force_makes_no_difference(unit):
    added = np.random.default_rng(4).normal(0.0, 0.1, (50, 2))
    changes = added @ [0.6, 0.3]
    assert gains_after(unit * changes, unit * added, unit) == pytest.approx(
        gains_after(changes, added)
    )


def test_frames_before_a_hole_are_not_compared_with_those_behind_it():
    gains = EventGains()
    gains.frame(0.0, np.zeros(2))
    gains.forget_frame()
    gains.frame(0.5, np.array([0.1, 0.1]))
    assert tuple(gains.value) == EventGains.PRIOR
    gains.frame(0.7, np.array([0.2, 0.2]))
    assert (gains.value > EventGains.PRIOR).all()


def moving_path(unit: float, forces: list[float]) -> ForcePath:
    """Return a path whose increments were these [unit]: no memory, and events as large."""
    config = FgerConfig(force_unit=unit)
    tensors = random_model(config).tensors
    tensors['increment.0.weight'][:, : config.lstm_size] = 0.0
    for layer in ('event.hidden', 'event.output', 'increment.0'):
        tensors[f'{layer}.bias'][:] = 0.0
    once = ForcePath(config, tensors)
    once.step(BURST)
    scale = np.float32(unit * EventGains.PRIOR[0] / once.value[0])
    weights = {**tensors, 'increment.2.weight': scale * tensors['increment.2.weight']}
    path = ForcePath(config, weights)
    for force in forces:
        path.step(np.float32(force) * BURST)
    return path


@pytest.mark.parametrize('unit', [0.5, 3.0])
def test_a_blow_is_found_around_its_windows_and_a_motion_is_none(unit):
    quiet, half = [0.0] * 20, 3
    path = moving_path(unit, [*quiet, 1.5 * BLOW_N, *quiet])
    assert [lag for lag in range(40) if path.blow(lag, half)] == list(range(17, 24))
    assert not path.blow(500, half)
    path = moving_path(unit, [*quiet, *[0.05 * BLOW_N] * 20])
    assert path.value[0] == pytest.approx(unit * BLOW_N * EventGains.PRIOR[0], rel=1e-3)
    assert not any(path.blow(lag, half) for lag in range(40))


def test_the_force_is_that_of_the_frame_and_what_both_ways_have_added_since():
    path = moving_path(1.0, [0.02] * 30)
    press = np.full_like(STILL, 0.03 / BURST[..., :2].size)
    path.correct(shown(path.value[0], press), 0)
    for _ in range(10):
        path.step(BURST)
    path.correct(shown(0.4, press), 4)
    added = 4.0 * (np.array([1.0, 0.03]) @ path.gains.value)
    assert path.moved[0] == pytest.approx(added, rel=1e-3)
    assert path.value[0] == pytest.approx(0.4 + added, rel=1e-3)
    path.correct(shown(0.7), 0)
    assert (path.value[0], path.moved[0]) == (0.7, 0.0)


def test_the_gains_outlive_a_restart_of_the_state():
    path = moving_path(1.0, [])
    for count in range(1, 41):
        path.step(np.float32(0.1) * BURST)
        # Frames that show more than the events do, again and again.
        path.correct(shown(0.2 * count), 0)
    learned = path.gains.value
    assert learned[0] > EventGains.PRIOR[0]
    path.start_at(shown(0.3))
    assert path.value[0] == 0.3
    assert (path.gains.value == learned).all()
    path.change_sensor()
    assert tuple(path.gains.value) == EventGains.PRIOR
