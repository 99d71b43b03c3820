# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Relaxation, creep and hysteresis of a contact against quasi-linear viscoelasticity on paper."""

import numpy as np
import pytest

from mixtac_sim.grids import STEP_US
from mixtac_sim.mechanics.contact import Contact, Mode, PronySeries
from mixtac_sim.mechanics.elastomer import HEMISPHERE, Layer, force_law
from mixtac_sim.world.device import draw_device
from mixtac_sim.world.effects import preset

STEP_S = 1e-6 * STEP_US
SERIES = PronySeries((0.3, 0.05, 0.04, 0.02), (0.003, 0.05, 1.0, 20.0))
LAW = force_law(Layer(160.0, 4.0), HEMISPHERE, 5.0)


def drive(mode, targets, prony=SERIES, law=LAW):
    steps = len(targets)
    return Contact([law], [0.0], prony).advance(
        np.full(steps, mode, np.int8), np.asarray(targets, np.float64), np.zeros(steps, np.int8)
    )


@pytest.mark.parametrize('rise_s', [0.02, 0.3])
def test_held_depth_relaxes_as_the_hereditary_integral_says(rise_s):
    depth, seconds = 0.5, 3.0
    t = STEP_S * np.arange(1, round(seconds / STEP_S) + 1)
    path = drive(Mode.POSITION, np.minimum(t / rise_s, 1.0) * depth)
    speed = depth / rise_s
    for now in (0.5 * rise_s, rise_s, rise_s + 0.01, rise_s + 0.3, 2.9):
        moving = np.linspace(0.0, min(now, rise_s), 20_001)
        steps = np.diff([LAW.force_at(u * speed) for u in moving])
        age = now - 0.5 * (moving[1:] + moving[:-1])
        kernel = 1.0 + sum(
            g * np.exp(-age / tau) for g, tau in zip(SERIES.weights, SERIES.times_s, strict=True)
        )
        expected = np.sum(kernel * steps)
        assert path.force_n[round(now / STEP_S) - 1] == pytest.approx(expected, rel=3e-3)


def test_held_force_creeps_with_the_retardation_times():
    # 1 + sum g s / (s + 1 / tau) has its roots at minus the inverse retardation times.
    force, rates = 0.6, 1.0 / np.array(SERIES.times_s)
    whole = np.poly(-rates)
    top = whole.copy()
    for k, weight in enumerate(SERIES.weights):
        others = np.poly(-np.delete(rates, k))
        top = np.polyadd(top, weight * np.append(others, 0.0))
    roots = np.real(np.roots(top))
    shares = [
        np.polyval(whole, root) / (root * np.polyval(np.polyder(top), root)) for root in roots
    ]
    path = drive(Mode.FORCE, np.full(round(4.0 / STEP_S), force))
    t = STEP_S * np.arange(1, len(path.elastic_n) + 1)
    compliance = 1.0 + sum(c * np.exp(r * t) for c, r in zip(shares, roots, strict=True))
    chosen = t > 0.001  # the first step is a ramp, not a jump
    np.testing.assert_allclose(path.elastic_n[chosen], force * compliance[chosen], rtol=5e-3)
    assert path.depth_mm[-1] > 1.1 * path.depth_mm[8]


@pytest.mark.parametrize('name', ['easy', 'paper_like', 'hard'])
def test_slow_loops_lose_as_much_as_soft_silicone(name):
    # 3 to 10 % of the work after run-in, up to 20 % before (estimates of the literature).
    lost = []
    for seed in range(6):
        device = draw_device(seed, preset(name))
        law = force_law(device.layer, HEMISPHERE, device.mesh_n_per_mm, device.stiffening)
        depth = law.depth_at(0.8)
        ramp = np.linspace(0.0, depth, round(1.0 / STEP_S))
        path = drive(Mode.POSITION, np.concatenate([ramp, ramp[::-1]]), device.prony, law)
        half = len(ramp)
        up = np.trapezoid(path.force_n[:half], path.position_mm[:half])
        down = -np.trapezoid(path.force_n[half:], path.position_mm[half:])
        lost.append(1.0 - down / up)
    assert 0.03 < np.mean(lost) < 0.2
    assert max(lost) < 0.25
