# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The stiffness of the contact against batch least squares, its probe, and the bound."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixtac_slip_control.bounds import (
    DRIFT,
    GAIN_SIGMAS,
    RESERVE,
    SIGMAS,
    AdvanceBound,
    ContactStiffness,
    StiffnessProbe,
    stiffening,
)
from mixtac_slip_control.errors import SlipControlError
from mixtac_slip_control.parameters import SlipControlParameters

PARAMETERS = SlipControlParameters(probe_advance=1e-5, probe_force=0.1, probe_speed=1e-3)
STILL = 1e-9


def fed(places: np.ndarray, forces: np.ndarray, drift: float = STILL) -> ContactStiffness:
    stiffness = ContactStiffness(PARAMETERS, drift)
    for k, (place, force) in enumerate(zip(places, forces, strict=True)):
        stiffness.on_force(float(force), 2000 * k, (float(place), float(place)))
    return stiffness


@settings(max_examples=60)
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


@settings(max_examples=100)
@given(st.floats(500.0, 2e4), st.floats(0.1, 1.0), st.integers(1, 40), st.floats(0.1, 2.0))
def test_the_largest_advance_is_where_the_upper_bound_meets_the_force(
    k: float, force: float, number: int, goal: float
) -> None:
    x = np.linspace(0.0, 3e-5, number)
    stiffness = fed(x, force + k * x)
    found = stiffness.largest_advance(goal)
    grid = np.linspace(0.0, 2.0 * min(found, 1e-2) + 1e-6, 4001)
    spread = np.array([stiffness.force_variance(at) for at in grid])
    slope = RESERVE * stiffening(stiffness.force, goal) * stiffness.stiffness
    bound = stiffness.force + slope * grid
    bound += SIGMAS * np.sqrt(spread)
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


def test_forces_that_are_no_measurements_allow_no_advance() -> None:
    stiffness = fed(np.zeros(6), np.array([0.5, 1.7e308, -1.7e308, 1.7e308, 0.5, 0.5]))
    assert stiffness.largest_advance(1.3) == 0.0


def test_a_soft_contact_gives_more_room_once_it_is_known() -> None:
    x = np.concatenate([np.zeros(50), np.linspace(0.0, 5e-5, 50), np.full(50, 5e-5)])
    noise = np.random.default_rng(1).normal(0.0, 0.03, len(x))
    stiffness = fed(x, 0.6 + 1e3 * x + noise, DRIFT)
    assert 1e3 < stiffness.bound < 2.5e3
    assert stiffness.largest_advance(1.3) > 2e-4


def test_a_place_that_is_not_sure_says_less() -> None:
    sure, unsure = (ContactStiffness(PARAMETERS, STILL) for _ in range(2))
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


def started() -> StiffnessProbe:
    probe = StiffnessProbe(PARAMETERS, precision=0.1, longest_s=0.03)
    probe.start()
    return probe


def test_it_goes_out_waits_and_comes_back_in_its_steps() -> None:
    probe, places = started(), [0.0]
    while probe.active:
        probe.update(1e3, 1e3, 1.0)
        places.append(probe.advance)
    assert max(places) == pytest.approx(1e-5)
    assert max(abs(b - a) for a, b in itertools.pairwise(places)) <= 1.0001e-6
    assert len(places) == pytest.approx(1 + 30 + 10, abs=1)
    assert places[-1] == 0.0


@pytest.mark.parametrize('window_s', [2e-4, 1e-3, 1e-2])
def test_it_takes_a_quarter_of_a_second_at_most_whatever_the_window(window_s: float) -> None:
    probe = StiffnessProbe(SlipControlParameters(window=window_s, max_events_age=0.05))
    probe.start()
    windows, most = 0, 0.0
    while probe.active:
        probe.update(1e3, 1e3, 1.0)
        windows, most = windows + 1, max(most, probe.advance)
    assert windows * window_s <= 0.28
    assert most == pytest.approx(5e-5)


def test_it_returns_as_soon_as_the_stiffness_is_known() -> None:
    probe = started()
    for _ in range(4):
        probe.update(1e3, 200.0, 1.0)
    probe.update(1e3, 99.0, 1.0)
    # What is less sure while it returns does not turn it round.
    places = [probe.advance]
    while probe.active:
        probe.update(1e3, 200.0, 1.0)
        places.append(probe.advance)
    assert places == sorted(places, reverse=True)


def test_it_waits_where_the_force_has_grown_enough() -> None:
    probe = started()
    for _ in range(20):
        probe.update(2e4, 1e4, 1.0)
    assert 5e-6 <= probe.advance <= 6.1e-6


def test_it_stays_within_what_the_force_allows() -> None:
    probe = started()
    for _ in range(10):
        probe.update(1e3, 1e3, 3.5e-6)
    assert probe.advance == pytest.approx(3.5e-6)


def test_taking_over_ends_it_and_returns_its_advance() -> None:
    probe = started()
    probe.update(1e3, 1e3, 1.0)
    assert probe.take_over() == pytest.approx(1e-6)
    assert (probe.advance, probe.active) == (0.0, False)


def test_an_advance_of_zero_does_not_probe() -> None:
    probe = StiffnessProbe(SlipControlParameters(probe_advance=0.0))
    probe.start()
    assert not probe.active


def test_the_bound_never_falls_below_what_is_commanded_and_ends_at_max_total() -> None:
    bound = AdvanceBound(SlipControlParameters(max_total=2e-5))
    bound.stiffness.on_force(0.5, 0, (0.0, 0.0))
    preload, start = bound.start()
    assert preload == pytest.approx(0.5)
    assert start == bound.limit(0.0, 0.5) == 2e-5
    # A smaller max_total, or a force near the ceiling, makes the arm wait where it is.
    bound.configure(SlipControlParameters(max_total=1e-5))
    assert bound.limit(1.5e-5, 0.5) == 1.5e-5
    assert bound.limit(3e-6, 0.95 * 1.5) == 3e-6


def test_a_force_without_room_is_refused() -> None:
    bound = AdvanceBound(SlipControlParameters())
    bound.stiffness.on_force(1.4, 0, (0.0, 0.0))
    with pytest.raises(SlipControlError) as caught:
        bound.start()
    assert 'max_force' in caught.value.remedy


def settled() -> AdvanceBound:
    """Return the bound of a contact of 5 N/mm at 0.5 N whose probe has ended."""
    bound = AdvanceBound(SlipControlParameters())
    for k, place in enumerate(np.linspace(0.0, 4e-5, 200)):
        bound.stiffness.on_force(0.5 + 5e3 * place, 2000 * k, (place, place))
    bound.stiffness.settle()
    return bound


def test_a_sensor_that_loses_sight_of_a_fast_press_does_not_make_room() -> None:
    bound = settled()
    before = bound.limit(0.0, 0.5)
    for k in range(200):
        # It shows a tenth of what the press adds, and less of the force at rest.
        bound.stiffness.on_force(0.45, 400_000 + 2000 * k, (1.5e-4, 1.5e-4))
    assert bound.stiffness.stiffness >= 4.9e3
    assert bound.limit(0.0, 0.5) <= 1.1 * before


def test_a_contact_that_turns_out_stiffer_takes_room_away() -> None:
    bound = settled()
    before = bound.limit(0.0, 0.5)
    for k in range(200):
        bound.stiffness.on_force(0.5 + 8e3 * 1e-4, 400_000 + 2000 * k, (1e-4, 1e-4))
    assert bound.limit(0.0, 0.5) < 0.8 * before


def test_an_uncertain_sensor_leaves_less_room() -> None:
    bound = settled()
    before = bound.goal
    for _ in range(1000):
        bound.upper(0.5, 0.1, (0.0, 0.0), calm=True)
    assert bound.goal == pytest.approx(before / (1.0 + GAIN_SIGMAS * 0.1 / 0.7), rel=0.02)


def test_the_gain_stays_as_well_known_as_before_a_slip() -> None:
    bound = settled()
    for _ in range(99):
        bound.upper(0.5, 0.05, (0.0, 0.0), calm=True)
    bound.on_slip()
    for _ in range(1000):
        bound.upper(0.5, 0.1, (0.0, 0.0), calm=True)
    unsettled = bound.goal
    bound.on_slip()
    for _ in range(1000):
        bound.upper(0.5, 0.3, (0.0, 0.0), calm=True)
    assert bound.goal == unsettled
    bound.start()
    bound.probe.take_over()
    for _ in range(1000):
        bound.upper(0.5, 0.3, (0.0, 0.0), calm=True)
    assert bound.goal < unsettled


def test_the_upper_bound_rests_on_the_better_of_sensor_and_advance() -> None:
    bound = settled()
    place = (1e-4, 1e-4)
    burst = bound.upper(1.8, 1.5, place, calm=False)
    assert 1.0 < burst < 1.2
    sure = bound.upper(1.8, 0.02, place, calm=False)
    assert sure == pytest.approx(1.76, abs=0.1)
    assert bound.upper(1.8, 0.0, place, calm=False) == 1.8
