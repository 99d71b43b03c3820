# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The lower bound: the best motion keeps the limits of the arm; when objects come to rest."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixtac_lab.slip.loop import GRID_S, ArmReach, arrest_of, fastest_way


@settings(max_examples=50)
@given(st.floats(0.02, 3.0), st.floats(1.0, 8.0), st.floats(800.0, 4000.0))
def test_best_motion_keeps_acceleration_and_jerk(distance: float, a: float, jerk: float) -> None:
    way = fastest_way(distance, ArmReach(a, jerk, 0.0, 1.5), 2000)
    path = np.concatenate([np.zeros(3), way])
    acceleration = np.diff(path, 2) / GRID_S**2 * 1e-3
    assert np.abs(acceleration).max() <= a * 1.001
    # The ramps are cut to whole steps of the grid.
    width = max(round(a / jerk / GRID_S), 1)
    bound = 2.0 * a / (width * GRID_S)
    assert np.abs(np.diff(acceleration) / GRID_S).max() <= bound * 1.001
    assert way[-1] == pytest.approx(distance, rel=1e-9)
    assert np.all(np.diff(way) >= -1e-12)


def test_best_motion_takes_the_time_of_bang_bang_and_a_ramp() -> None:
    # 0.5 mm at 5 m/s2: twice the root of d / a is 20 ms; the jerk of 2500 adds 2 ms.
    way = fastest_way(0.5, ArmReach(5.0, 2500.0, 0.0, 1.5), 400)
    arrival = np.flatnonzero(way >= 0.5 - 1e-9)[0] * GRID_S
    assert arrival == pytest.approx(22e-3, abs=5e-4)


def test_lag_delays_by_its_time_constant() -> None:
    quick = fastest_way(0.5, ArmReach(5.0, 2500.0, 0.0, 1.5), 4000)
    slow = fastest_way(0.5, ArmReach(5.0, 2500.0, 4e-3, 1.5), 4000)
    assert np.sum(quick - slow) * GRID_S / 0.5 == pytest.approx(4e-3, rel=0.05)


def test_arrest_is_when_the_object_stands_still_for_good() -> None:
    t_us = (np.arange(800) + 1) * 125
    speed = np.zeros(800)
    speed[80:160] = 10.0
    speed[200:240] = 2.0
    place = np.cumsum(speed) * 125e-6
    arrest = arrest_of(t_us, place, speed, 10_000)
    assert arrest.slip_mm == pytest.approx(0.11)
    assert arrest.arrest_ms == pytest.approx(20.0)
    assert arrest.held


def test_what_moves_at_the_end_is_not_held() -> None:
    t_us = (np.arange(800) + 1) * 125
    arrest = arrest_of(t_us, np.linspace(0, 1, 800), np.full(800, 10.0), 10_000)
    assert np.isnan(arrest.arrest_ms)
    assert not arrest.held
