# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The reference sensor, its drift, the mount, and the inertial unit."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import cont2discrete, dlsim

from mixtac_sim.world.effects import EASY, preset
from mixtac_sim.world.instruments import InertialUnit, Mount, ReferenceSensor, Wander

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


PAPER = preset('paper_like')


def test_drift_saturates_at_the_deviation_of_its_process():
    at = np.array([1.0, 30.0, 300.0, 3000.0])
    drifts = np.stack([Wander(np.random.default_rng(k), 30.0).at(at) for k in range(150)])
    spread = drifts.transpose(1, 0, 2).reshape(4, -1).std(axis=1)
    # Zeroed at 0: the variance of a difference, 2 [1 - exp(-t / T)].
    np.testing.assert_allclose(spread, np.sqrt(2.0 * (1.0 - np.exp(-at / 30.0))), rtol=0.08)
    assert np.abs(drifts).max() <= 6.0


BLOW_US = np.arange(1, 8_001) * 125


def blow(start_us=100_000, length_us=5_000, force=10.0):
    wrench = np.zeros((len(BLOW_US), 6))
    since = BLOW_US - start_us
    inside = (since > 0) & (since <= length_us)
    wrench[inside, 2] = force * np.sin(np.pi * since[inside] / length_us)
    return wrench


def simulated(resonance_hz, damping, force):
    """Return force passed on and m times acceleration of a damped oscillator, by scipy."""
    w = 2.0 * np.pi * resonance_hz
    a, b = [[0.0, 1.0], [-w * w, -2.0 * damping * w]], [[0.0], [w * w]]
    c, d = [[1.0, 0.0], [-1.0, -2.0 * damping / w]], [[0.0], [1.0]]
    system = cont2discrete(tuple(map(np.array, (a, b, c, d))), 125e-6, 'zoh')
    _, _, state = dlsim(system, np.append(force, 0.0))
    arrived, speed = state[1:].T
    return arrived, force - arrived - 2.0 * damping / w * speed


@pytest.mark.parametrize(('resonance', 'damping'), [(250.0, 0.05), (900.0, 0.02)])
def test_ringing_is_that_of_a_damped_oscillator(resonance, damping):
    wrench = blow()
    arrived, left = Mount(resonance, damping).swing(BLOW_US, wrench)
    force, shaken = simulated(resonance, damping, wrench[:, 2])
    np.testing.assert_allclose(arrived[:, 2], force, atol=1e-8)
    np.testing.assert_allclose(left[:, 2], shaken, atol=1e-8)
    assert np.abs(arrived[:, :2]).max() == 0.0


def test_a_mount_rings_in_pieces_as_in_the_whole():
    wrench, mount = blow(), Mount(300.0, 0.03)
    parts = [mount.swing(BLOW_US[a : a + 37], wrench[a : a + 37])[0] for a in range(0, 8_000, 37)]
    whole, _ = Mount(300.0, 0.03).swing(BLOW_US, wrench)
    np.testing.assert_allclose(np.concatenate(parts), whole, atol=1e-12)


def test_inertial_unit_feels_an_impact_and_nothing_before():
    still, struck = InertialUnit(4), InertialUnit(4)
    struck.feel(BLOW_US, blow())
    before, after = (
        np.array([r.acceleration_g for r in u.readings(1_000_000, 1_000)]) for u in (still, struck)
    )
    felt = after - before
    assert np.abs(felt[:99]).max() == 0.0
    assert 0.05 < np.abs(felt[100:110]).max() < 8.0
    assert np.abs(felt[:, :2]).max() == 0.0
    # What is struck comes to rest again: no velocity is left.
    assert abs(felt[:, 2].sum()) < 0.2 * np.abs(felt[:, 2]).sum()
    assert EASY.impact.ringing_hz == (0.0, 0.0)
