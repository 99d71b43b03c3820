# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Rate-and-state friction of the skin against its closed forms."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numba import njit
from scipy.optimize import brentq

from mixtac_sim.grasp.objects import REFERENCE_MM_S, Friction
from mixtac_sim.grasp.skin import Skin, make_skin, slide, slip_speed
from mixtac_sim.mechanics.elastomer import Layer, shear_stiffness

LAYER = Layer(160.0, 4.0)
EVEN = Friction(roughness=0.0, slip_mm=0.02)
STEP_S = 15.625e-6


@njit
def _drag(skin: Skin, speed: float, force: float, step: float, count: int) -> None:
    for _ in range(count):
        slide(skin, force, speed, step)


def _pull_n(skin: Skin) -> float:
    return float(np.dot(skin.stiffness, skin.shear_mm))


def _skin(pull_n: float, rest_s: float) -> Skin:
    skin = make_skin(LAYER, 6.0, EVEN, np.random.default_rng(0))
    skin.shear_mm[:], skin.age_s[:] = pull_n / skin.stiffness.sum(), rest_s
    return skin


@settings(max_examples=1000)
@example(1.15625, 1.09375, 0.005859375, 6.103515625e-05)
@given(st.floats(1e-3, 2.0), st.floats(-1.0, 2.0), st.floats(1e-4, 0.05), st.floats(1e-6, 1e-2))
def test_slip_speed_solves_its_equation(
    drive: float, strength: float, rate: float, damping: float
) -> None:
    def off(log_w: float) -> float:
        return rate * log_w + strength + damping * np.exp(log_w) - drive

    root = brentq(off, -3e5, np.log(1e5 * drive / damping + 1e9), xtol=1e-12)
    assert slip_speed(drive, strength, rate, damping) == pytest.approx(
        np.exp(root), rel=1e-8, abs=1e-12
    )


@pytest.mark.parametrize('speed', [1.0, 10.0, 50.0])
def test_steady_sliding_pulls_with_the_steady_coefficient(speed: float) -> None:
    skin, force = _skin(0.5, 1.0), 0.8
    count = round(60 * EVEN.slip_mm / speed / STEP_S) + 20_000
    _drag(skin, speed, force, STEP_S, count)
    steady = EVEN.mu + (EVEN.rate - EVEN.ageing) * np.log(speed / REFERENCE_MM_S)
    assert _pull_n(skin) == pytest.approx(steady * force, rel=2e-3)


def test_below_friction_the_gel_is_a_spring() -> None:
    skin = _skin(0.0, 10.0)
    # 20 um at 2 mm/s under 2 N: the pull stays far below friction.
    _drag(skin, 2.0, 2.0, STEP_S, 640)
    assert _pull_n(skin) == pytest.approx(shear_stiffness(LAYER, 6.0) * 0.02, rel=1e-3)
    assert skin.slid_mm.max() < 1e-5


def test_a_rested_contact_is_stronger_than_a_sliding_one() -> None:
    peak, steady = [], []
    for rest_s in (0.1, 10.0):
        skin = _skin(0.5, rest_s)
        pulls = []
        for _ in range(300):
            _drag(skin, 10.0, 0.8, STEP_S, 8)
            pulls.append(_pull_n(skin))
        peak.append(max(pulls))
        steady.append(pulls[-1])
    assert peak[0] > 1.02 * steady[0]
    assert peak[1] > peak[0]
