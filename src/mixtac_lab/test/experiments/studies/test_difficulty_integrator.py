# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The event-only integrator, on increments whose best map and drift are known."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from mixtac_events.arrays import Events
from mixtac_lab.experiments.studies.difficulty import (
    WINDOW_US,
    EventIntegrator,
    Increments,
    increments,
    judge_integrator,
    summarise_integrator,
)
from mixtac_learning.trials.trial import DatasetError, ForceLabel

CELLS = 8 * 6


def made(rng, gains, noise, windows=2000):
    """Return a trial whose increments are a linear map of its features, plus noise."""
    features = rng.poisson(3.0, (windows, len(gains))) - 3.0
    change = features @ gains + noise * rng.normal(size=windows)
    force = np.concatenate([[0.2], 0.2 + np.cumsum(change)])
    return Increments(np.arange(1, windows + 1) * WINDOW_US, features, force)


def test_exact_increments_integrate_without_drift():
    rng = np.random.default_rng(1)
    gains = rng.normal(0.0, 1e-3, 12)
    integrator = EventIntegrator.fit([made(rng, gains, 0.0) for _ in range(3)], 1e-6)
    np.testing.assert_allclose(integrator.gains, gains, rtol=0.01, atol=1e-5)
    quarters, r2 = judge_integrator(integrator, [made(rng, gains, 0.0)])
    assert r2 > 0.99999
    assert quarters.max() < 1e-2


def test_noise_at_rest_does_not_add_up():
    """ON events without motion, 3 in every window: their gain is taken back by the offset."""
    rng = np.random.default_rng(5)
    gains = rng.normal(0.0, 1e-3, 12)

    def noisy():
        trial = made(rng, gains, 0.0)
        return Increments(trial.t_us, trial.features + 3.0, trial.force)

    quarters, _ = judge_integrator(EventIntegrator.fit([noisy(), noisy()], 1e-6), [noisy()])
    assert quarters.max() < 0.02


def test_penalty_is_the_one_that_serves_trials_left_out():
    """Many features that mean nothing: a penalty helps where data are few, and none else."""
    rng = np.random.default_rng(6)
    gains = np.concatenate([[1e-2], np.zeros(150)])
    few = [made(rng, gains, 2e-2, windows=60) for _ in range(4)]
    unseen = [made(rng, gains, 2e-2, windows=60) for _ in range(20)]
    chosen = judge_integrator(EventIntegrator.choose(few), unseen)[0].mean()
    assert chosen < judge_integrator(EventIntegrator.fit(few), unseen)[0].mean()


def test_what_events_miss_grows_as_a_random_walk_does():
    """Mean |error| of a walk at step n is sd sqrt(2 n / pi); a quarter averages that."""
    rng = np.random.default_rng(2)
    gains = rng.normal(0.0, 1e-3, 12)
    integrator = EventIntegrator(gains)
    quarters, _ = judge_integrator(integrator, [made(rng, gains, 2e-3) for _ in range(400)])
    steps = np.arange(1, 2001)
    expected = 2e-3 * np.sqrt(2.0 * steps / np.pi).reshape(4, 500).mean(axis=1)
    np.testing.assert_allclose(quarters.mean(axis=0), expected, rtol=0.1)
    figures = summarise_integrator(quarters, 0.5)
    assert figures['integrator_growth'] == pytest.approx(expected[3] / expected[0], rel=0.1)
    assert figures['integrator_growing'] > 0.75


def test_features_are_sums_over_the_events_of_a_window():
    rng = np.random.default_rng(3)
    n = 500
    events = Events(
        np.sort(rng.integers(0, 100_000, n)),
        rng.integers(0, 346, n).astype(np.uint16),
        rng.integers(0, 260, n).astype(np.uint16),
        rng.random(n) < 0.6,
    )
    image = np.exp(rng.normal(5.0, 0.3, (260, 346)))
    later = np.zeros((260, 346))
    trial = SimpleNamespace(
        events=events,
        frames=np.stack([image, image, later]),
        exposure_end_us=np.array([7_000, 20_000, 60_000]),
    )
    label = ForceLabel(np.array([0.0, 90_000.0]), np.array([0.0, 0.9]))
    found = increments(trial, label, 2)
    assert found.t_us.tolist() == list(range(30_000, 90_001, WINDOW_US))
    np.testing.assert_allclose(found.force, 1e-5 * np.arange(20_000, 90_001, WINDOW_US), rtol=1e-5)
    slopes = np.gradient(np.log(image))
    expected = np.zeros((7, 4, CELLS))
    for t, x, y, on in zip(events.t, events.x, events.y, events.polarity, strict=True):
        if 20_000 <= t < 90_000:
            row = expected[(t - 20_000) // WINDOW_US, :, y // 44 * 8 + x // 44]
            row += (
                (1, -1)[not on] * slopes[1][y, x],
                (1, -1)[not on] * slopes[0][y, x],
                on,
                not on,
            )
    np.testing.assert_allclose(found.features, expected.reshape(7, -1), atol=1e-9)


def test_a_trial_that_is_all_reference_is_refused():
    trial = SimpleNamespace(exposure_end_us=np.array([7_000, 20_000]))
    label = ForceLabel(np.array([0.0, 30_000.0]), np.zeros(2))
    with pytest.raises(DatasetError):
        increments(trial, label, 2)
