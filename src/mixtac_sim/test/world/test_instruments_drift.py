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


def test_drift_does_not_depend_on_how_it_is_asked_for():
    t = np.linspace(0.0, 40.0, 801)
    whole = Wander(np.random.default_rng(3), 30.0).at(t)
    body = Wander(np.random.default_rng(3), 30.0)
    parts = [body.at(t[a : a + 50]) for a in range(0, 801, 50)]
    np.testing.assert_array_equal(np.concatenate(parts), whole)
    assert body.at(np.empty(0)).shape == (0, 6)


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
