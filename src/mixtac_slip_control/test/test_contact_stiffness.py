# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The stiffness of the contact: against batch least squares, and bounds that hold."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixtac_slip_control.bounds import ContactStiffness, StiffnessSettings, stiffening
from mixtac_slip_control.errors import SlipControlError

STILL = StiffnessSettings(drift=1e-9)


def fed(
    places: np.ndarray, forces: np.ndarray, chosen: StiffnessSettings = STILL
) -> ContactStiffness:
    stiffness = ContactStiffness(chosen)
    for k, (place, force) in enumerate(zip(places, forces, strict=True)):
        stiffness.on_force(float(force), 2000 * k, (float(place), float(place)))
    return stiffness


@settings(deadline=None, max_examples=60)
@given(st.floats(500.0, 2e4), st.floats(0.1, 1.0), st.integers(0, 10_000))
def test_it_is_batch_least_squares_with_the_prior(k: float, force: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    x = np.concatenate([np.zeros(5), np.cumsum(rng.uniform(0.0, 4e-6, 30))])
    y = force + k * x + rng.normal(0.0, 0.03, len(x))
    stiffness = fed(x, y)
    # The prior of k is one more measurement of it: half the stiffest, a third of that wide.
    rows = np.column_stack([np.ones(len(x)), x]) / 0.03
    rows = np.vstack([rows, [0.0, 3.0 / 1e4]])
    wanted, *_ = np.linalg.lstsq(rows, np.append(y / 0.03, 3.0), rcond=None)
    covariance = np.linalg.inv(rows.T @ rows)
    assert stiffness.force == pytest.approx(wanted[0], rel=1e-5, abs=1e-6)
    assert stiffness.stiffness == pytest.approx(wanted[1], rel=1e-5)
    assert stiffness.deviation == pytest.approx(math.sqrt(covariance[1, 1]), rel=1e-5)


@settings(deadline=None, max_examples=100)
@given(st.floats(500.0, 2e4), st.floats(0.1, 1.0), st.integers(1, 40), st.floats(0.1, 2.0))
def test_the_largest_advance_is_where_the_upper_bound_meets_the_force(
    k: float, force: float, number: int, goal: float
) -> None:
    x = np.linspace(0.0, 3e-5, number)
    stiffness = fed(x, force + k * x)
    found = stiffness.largest_advance(goal)
    chosen = stiffness.settings
    grid = np.linspace(0.0, 2.0 * min(found, 1e-2) + 1e-6, 4001)
    spread = stiffness._ff + 2.0 * grid * stiffness._fk + grid**2 * stiffness._kk
    slope = chosen.reserve * stiffening(stiffness.force, goal) * stiffness.stiffness
    bound = stiffness.force + slope * grid
    bound += chosen.sigmas * np.sqrt(spread)
    above = np.flatnonzero(bound >= goal)
    assert len(above)
    assert found == pytest.approx(grid[above[0]], abs=2.0 * grid[1])


@given(st.floats(0.2, 1.0), st.floats(1.05, 4.0))
def test_a_sphere_stiffens_as_hertz_says(force: float, ratio: float) -> None:
    depths = np.array([force, ratio * force]) ** (2.0 / 3.0)
    secant = (ratio - 1.0) * force / (depths[1] - depths[0])
    local = 1.5 * depths[0] ** 0.5
    assert stiffening(force, ratio * force) == pytest.approx(secant / local)
    assert stiffening(ratio * force, force) == 1.0


def test_nothing_measured_counts_as_the_stiffest_contact() -> None:
    stiffness = fed(np.zeros(400), np.full(400, 0.6))
    assert stiffness.bound == pytest.approx(2e4)
    # Of the room of 0.7 N nothing more than the stiffest contact would take.
    assert stiffness.largest_advance(1.3) < 0.7 / 2e4


def test_a_soft_contact_gives_more_room_once_it_is_known() -> None:
    x = np.concatenate([np.zeros(50), np.linspace(0.0, 5e-5, 50), np.full(50, 5e-5)])
    noise = np.random.default_rng(1).normal(0.0, 0.03, len(x))
    stiffness = fed(x, 0.6 + 1e3 * x + noise, StiffnessSettings())
    assert 1e3 < stiffness.bound < 2.5e3
    assert stiffness.largest_advance(1.3) > 2e-4


def test_a_place_that_is_not_sure_says_less() -> None:
    sure, unsure = ContactStiffness(STILL), ContactStiffness(STILL)
    for k in range(20):
        sure.on_force(0.6, 2000 * k, (1e-5, 1e-5))
        unsure.on_force(0.6, 2000 * k, (0.0, 2e-5))
    assert unsure.deviation > sure.deviation


def test_a_restart_keeps_the_force_and_forgets_the_stiffness() -> None:
    x = np.linspace(0.0, 5e-5, 100)
    stiffness = fed(x, 0.6 + 1e3 * x)
    assert stiffness.restart() == pytest.approx(0.65, abs=5e-3)
    assert stiffness.force == stiffness.present
    assert stiffness.bound == pytest.approx(2e4)


def test_no_room_is_no_advance() -> None:
    stiffness = fed(np.zeros(10), np.full(10, 1.4))
    assert stiffness.largest_advance(1.35) == 0.0
    assert stiffness.largest_advance(1.4001) == 0.0


@pytest.mark.parametrize('bad', [{'stiffest': 0.0}, {'force_noise': math.nan}, {'reserve': 0.9}])
def test_bad_settings_are_refused(bad: dict[str, float]) -> None:
    with pytest.raises(SlipControlError, match='give'):
        StiffnessSettings(**bad)
