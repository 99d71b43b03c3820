# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Drift and cross-talk of the reference sensor in the harder presets; its clock at their noise."""

import numpy as np
import pytest

from mixtac_sim.world.effects import preset
from mixtac_sim.world.instruments import ReferenceSensor, Wander

PAPER = preset('paper_like')


def test_drift_saturates_at_the_deviation_of_its_process():
    at = np.array([1.0, 30.0, 300.0, 3000.0])
    drifts = np.stack([Wander(np.random.default_rng(k), 30.0).at(at) for k in range(150)])
    spread = drifts.transpose(1, 0, 2).reshape(4, -1).std(axis=1)
    # Zeroed at 0: the variance of a difference, 2 [1 - exp(-t / T)].
    np.testing.assert_allclose(spread, np.sqrt(2.0 * (1.0 - np.exp(-at / 30.0))), rtol=0.08)
    assert np.abs(drifts).max() <= 6.0


def test_drift_forgets_at_its_pace():
    path = Wander(np.random.default_rng(1), 20.0).at(np.arange(20_000.0))
    path -= path.mean(axis=0)
    ahead = np.mean(path[20:] * path[:-20]) / np.mean(path**2)
    assert ahead == pytest.approx(np.exp(-1.0), abs=0.08)


def test_drift_does_not_depend_on_how_it_is_asked_for():
    t = np.linspace(0.0, 40.0, 801)
    whole = Wander(np.random.default_rng(3), 30.0).at(t)
    body = Wander(np.random.default_rng(3), 30.0)
    parts = [body.at(t[a : a + 50]) for a in range(0, 801, 50)]
    np.testing.assert_array_equal(np.concatenate(parts), whole)
    assert body.at(np.empty(0)).shape == (0, 6)


def test_easy_readings_are_warm_after_half_a_minute():
    """Nothing but a wave of a few millinewtons is left of the drift, also after ten minutes."""
    sensor = ReferenceSensor(5)
    means = []
    for second in range(600):
        t_us = 1_000_000 * second + np.arange(1, 1_001) * 1000
        means.append(sensor.process(t_us, np.zeros((1_000, 6))).wrench[:, :3].mean(axis=0))
    early, late = np.mean(means[30:150], axis=0), np.mean(means[480:], axis=0)
    np.testing.assert_allclose(late, early, atol=3e-3)


def test_torques_leak_into_forces_where_asked_to():
    t_us = np.arange(1, 8_001) * 125
    wrench = np.zeros((8_000, 6))
    wrench[:, 3] = 0.05  # Nm: 1 % of it, for a sensor of 10 mm, is 50 mN
    quiet = PAPER.without('timing', 'impact')

    def forces(coupling):
        timing = type(quiet.timing)(
            0.0, 0.0, (1.6e-3, 1.6e-3), (0.0, 0.0), 0.0, coupling, 0.0, 0.0, 0.0
        )
        chosen = type(quiet)('coupled', timing=timing)
        found = [
            ReferenceSensor(k, preset=chosen).process(t_us, wrench).wrench[200:, :3].mean(axis=0)
            for k in range(60)
        ]
        return np.concatenate(found)

    assert np.abs(forces(0.0)).max() == 0.0
    assert forces(0.01).std() == pytest.approx(0.05, rel=0.3)


def test_two_impulses_leave_one_to_two_milliseconds():
    t_us = np.arange(1, 160_001) * 125
    force = sum(1.5 * np.exp(-0.5 * ((1e-6 * t_us - centre) / 6e-3) ** 2) for centre in (0.6, 19.4))
    wrench = np.zeros((len(t_us), 6))
    wrench[:, 2] = force
    left = []
    for seed in range(12):
        sensor = ReferenceSensor(seed, preset=PAPER)
        samples = sensor.process(t_us, wrench)
        true_s = (1e-9 * samples.t_ns - sensor.offset_s) / (1.0 + 1e-6 * sensor.drift_ppm)
        first, last = (
            1e-9 * samples.t_ns[np.argmax(np.where(part, samples.wrench[:, 2], -9.0))]
            for part in (true_s < 10.0, true_s > 10.0)
        )
        slope = (last - first) / (19.4 - 0.6)
        left.append(first - slope * 0.6 - sensor.offset_s - sensor.delay_s)
    assert np.sqrt(np.mean(np.square(left))) < 2.2e-3
