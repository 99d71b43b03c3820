# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The reference sensor: clock, filter, noise, pieces."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixtac_sim.world.instruments import ReferenceSensor

T_US = np.arange(1, 16_001) * 125


def push(force, t_us=T_US):
    wrench = np.zeros((len(t_us), 6))
    wrench[:, 2] = force
    return wrench


def true_s(sensor, samples):
    return (1e-9 * samples.t_ns - sensor.offset_s) / (1.0 + 1e-6 * sensor.drift_ppm)


@pytest.mark.parametrize('seed', range(5))
def test_clock_is_off_by_offset_and_drift(seed):
    sensor = ReferenceSensor(seed)
    assert abs(sensor.offset_s) <= 5.0
    assert abs(sensor.drift_ppm) <= 100.0
    assert 1.5e-3 <= sensor.delay_s <= 3e-3
    samples = sensor.process(T_US, push(0.0))
    np.testing.assert_array_equal(np.diff(samples.t_ns), 1_250_000)
    assert len(samples.t_ns) == pytest.approx(1600, abs=5)
    assert true_s(sensor, samples)[-1] == pytest.approx(2.0, abs=1.3e-3)


@settings(max_examples=15)
@given(st.lists(st.integers(1, 15_999), max_size=8, unique=True), st.integers(0, 100))
def test_pieces_give_what_the_whole_gives(cuts, seed):
    rng = np.random.default_rng(seed)
    wrench = np.cumsum(rng.normal(0.0, 0.01, (len(T_US), 6)), axis=0)
    whole = ReferenceSensor(seed).process(T_US, wrench)
    sensor, edges = ReferenceSensor(seed), [0, *sorted(cuts), len(T_US)]
    parts = [sensor.process(T_US[a:b], wrench[a:b]) for a, b in pairwise(edges)]
    np.testing.assert_array_equal(np.concatenate([p.t_ns for p in parts]), whole.t_ns)
    np.testing.assert_allclose(np.concatenate([p.wrench for p in parts]), whole.wrench, atol=6e-3)


@pytest.mark.parametrize('seed', range(4))
def test_step_arrives_after_the_delay(seed):
    sensor = ReferenceSensor(seed)
    samples = sensor.process(T_US, push(np.where(T_US > 1_000_000, 5.0, 0.0)))
    force = samples.wrench[:, 2]
    k = int(np.argmax(force > 2.5))
    before, after = force[k - 1], force[k]
    crossing = true_s(sensor, samples)[k - 1] + 1.25e-3 * (2.5 - before) / (after - before)
    assert crossing - 1.0 == pytest.approx(sensor.delay_s, abs=3e-4)


def test_bandwidth_is_200_hz():
    def gain(frequency):
        sensor = ReferenceSensor(3)
        force = 5.0 * np.sin(2.0 * np.pi * frequency * 1e-6 * T_US)
        samples = sensor.process(T_US, push(force))
        wave = np.exp(-2j * np.pi * frequency * true_s(sensor, samples))
        return 2.0 * abs(np.mean(samples.wrench[:, 2] * wave)) / 5.0

    assert gain(20.0) == pytest.approx(1.0, abs=0.03)
    assert gain(200.0) == pytest.approx(0.71, abs=0.05)


def test_noise_gain_and_crosstalk_are_small():
    rest = ReferenceSensor(6).process(T_US, push(0.0)).wrench
    loaded = ReferenceSensor(6).process(T_US, push(3.0)).wrench
    assert 0.007 < rest[:, 2].std() < 0.021
    assert np.abs(rest.mean(axis=0)).max() < 0.02
    change = (loaded - rest)[200:].mean(axis=0)
    assert change[2] == pytest.approx(3.0, rel=0.015)
    assert 0.0 < np.hypot(*change[:2]) < 0.15
    steps = rest[:, 2] / 0.005
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
