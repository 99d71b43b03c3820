# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixtac_slip_control.arm.profile import fastest, integrate, jerks, land

V, A, J = 0.2, 3.0, 1500.0
DT = 1e-3


def play(phases, v, a, step=1e-5):
    """Integrate phases by small steps, apart from the closed forms of the module."""
    s, worst = 0.0, np.zeros(2)
    for duration, jerk in phases:
        count = int(duration / step) + 1
        h = duration / count
        for _ in range(count):
            s, v, a = (
                s + h * v + h * h * a / 2 + h**3 * jerk / 6,
                v + h * a + h * h * jerk / 2,
                a + h * jerk,
            )
            worst = np.maximum(worst, np.abs([v, a]))
    return s, v, a, worst


@settings(max_examples=60)
@given(st.floats(-0.01, 0.01), st.floats(-V, V), st.floats(-A, A))
def test_the_fastest_motion_ends_at_rest_at_its_target_within_limits(d, v, a):
    phases = fastest(d, v, a, V, A, J)
    assert (phases[:, 0] >= 0.0).all()
    assert np.isin(np.abs(phases[:, 1]), (0.0, J)).all()
    s, v_end, a_end, (top_v, top_a) = play(phases, v, a)
    assert (s, v_end, a_end) == pytest.approx((d, 0.0, 0.0), abs=1e-9)
    assert top_a <= A * (1 + 1e-9)
    # A start close to the limit of speed that is still accelerating must pass it.
    assert top_v <= V + a * a / (2 * J) + 1e-9


@pytest.mark.parametrize('d', [1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 5e-2])
def test_from_rest_the_time_is_the_textbooks(d):
    total = fastest(d, 0.0, 0.0, V, A, J)[:, 0].sum()
    if d <= 2 * A**3 / J**2:
        expected = 4 * (d / (2 * J)) ** (1 / 3)
    elif d <= V * (V / A + A / J):
        expected = A / J + np.sqrt((A / J) ** 2 + 4 * d / A)
    else:
        expected = d / V + V / A + A / J
    assert total == pytest.approx(expected, rel=1e-6)


@settings(max_examples=200)
@given(st.floats(-0.01, 0.01), st.floats(-V, V), st.floats(-A, A))
def test_on_the_grid_it_ends_at_rest_with_hardly_more_jerk(d, v, a):
    start = np.array([0.3, v, a])
    phases = fastest(d, v, a, V, A, J)
    jerk = jerks(phases, a, DT)
    assert np.abs(jerk).max() <= J * (1 + 1e-9)
    land(jerk, start, 0.3 + d, DT)
    states = integrate(jerk, start, 0.3 + d, DT)
    # Without the last state being set: one more step from the one before it.
    s, v1, a1 = states[-2]
    j = jerk[-1]
    assert s + DT * v1 + DT**2 * a1 / 2 + DT**3 * j / 6 == pytest.approx(0.3 + d, abs=1e-12)
    assert v1 + DT * a1 + DT**2 * j / 2 == pytest.approx(0.0, abs=1e-10)
    assert a1 + DT * j == pytest.approx(0.0, abs=1e-8)
    assert len(jerk) == max(np.ceil(phases[:, 0].sum() / DT - 1e-9), 6)


@given(st.integers(3, 60), st.integers(0, 2**32 - 1))
def test_landing_changes_the_jerk_least(cells, seed):
    rng = np.random.default_rng(seed)
    jerk, start, target = rng.normal(size=cells) * 100, rng.normal(size=3) * (1e-3, 0.1, 1), 0.01
    landed = jerk.copy()
    land(landed, start, target, DT)
    m = np.arange(cells)[::-1]
    maps = np.array([DT * np.ones(cells), DT**2 * (m + 0.5), DT**3 * (m * m / 2 + m / 2 + 1 / 6)])
    scale = np.array([1, DT, DT * DT])[:, None]
    T = cells * DT
    s, v, a = start
    missing = np.array([-a, -v - T * a, target - s - T * v - T * T * a / 2]) - maps @ jerk
    least = np.linalg.pinv(maps / scale) @ (missing / scale[:, 0])
    assert np.allclose(landed - jerk, least, rtol=1e-5, atol=1e-5 * np.abs(least).max())
