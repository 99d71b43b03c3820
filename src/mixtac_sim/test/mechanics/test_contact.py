# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Contact in time, against an integration of its own and linear viscoelasticity."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from mixtac_sim.grids import STEP_US
from mixtac_sim.mechanics.contact import GRAVITY, Contact, Mode, PronySeries
from mixtac_sim.mechanics.elastomer import HEMISPHERE, WEIGHT_20_G, Layer, force_law
from mixtac_sim.world.device import draw_device
from mixtac_sim.world.effects import preset

STEP_S = 1e-6 * STEP_US
DAMPED = PronySeries((0.3, 0.3, 0.04), (0.5e-3, 3e-3, 0.1))
TOOLS = (HEMISPHERE, WEIGHT_20_G)


def contact(prony=DAMPED):
    laws = [force_law(Layer(160.0, 4.0), tool, 5.0) for tool in TOOLS]
    return Contact(laws, [tool.mass_g for tool in TOOLS], prony)


def run(seconds, mode, targets, tool=0, body=None):
    n = round(seconds / STEP_S)
    values = np.broadcast_to(np.asarray(targets, np.float64), n).copy()
    return (body or contact()).advance(np.full(n, mode, np.int8), values, np.full(n, tool, np.int8))


def test_lift_takes_the_weight_off():
    body = contact()
    run(3.0, Mode.DROP, 1.0, tool=1, body=body)
    lifted = run(0.4, Mode.LIFT, np.linspace(0.0, 0.3, round(0.4 / STEP_S)), tool=1, body=body)
    assert lifted.force_n[0] > 0.1
    assert lifted.force_n[-1] == 0.0
    assert lifted.position_mm[-1] < 0.0


def test_commanded_force_is_met_and_the_dent_creeps():
    path = run(2.0, Mode.FORCE, 0.5)
    np.testing.assert_allclose(path.force_n, 0.5)
    assert np.all(np.diff(path.depth_mm) >= 0.0)
    assert path.depth_mm[-1] == pytest.approx(
        force_law(Layer(160.0, 4.0), HEMISPHERE, 5.0).depth_at(0.5), rel=1e-3
    )


def test_indenter_leaves_without_pulling():
    body = contact()
    run(0.5, Mode.POSITION, 0.5, body=body)
    away = run(0.1, Mode.POSITION, np.linspace(0.5, -0.2, 800), body=body)
    assert away.force_n.min() == 0.0
    assert away.force_n[-1] == 0.0
    assert away.depth_mm[-1] > 0.0
    rest = run(2.0, Mode.FREE, 0.0, body=body)
    assert rest.depth_mm[-1] < 0.2 * away.depth_mm[-1]


MASS_KG = 1e-3 * WEIGHT_20_G.mass_g
PAPER = preset('paper_like')


def simulated(law, prony, seconds):
    """Return landing and take-off times [s] and the path."""
    n = round(1e6 * seconds / STEP_US)
    body = Contact([law], [WEIGHT_20_G.mass_g], prony)
    modes, targets = np.full(n, Mode.DROP, np.int8), np.full(n, 50.0)
    path = body.advance(modes, targets, np.zeros(n, np.int8))
    edges = np.diff(np.concatenate([[0], path.force_n > 0.0, [0]]).astype(int))
    step = 1e-6 * STEP_US
    return np.flatnonzero(edges == 1) * step, np.flatnonzero(edges == -1) * step, path


def integrated(law, prony, contacts):
    """Return the lengths of contacts and flights [s] and the peak forces [N] of the oracle."""
    depths, forces = law.depths_mm, law.force_n
    slope = np.gradient(forces, depths)
    weights, times = np.array(prony.weights), np.array(prony.times_s)

    def total(state):
        return np.interp(state[0], depths, forces) + np.sum(state[2:])

    def touching(_t, state):
        rate = np.interp(state[0], depths, slope) * state[1]
        return [
            state[1],
            1e3 * (GRAVITY - total(state) / MASS_KG),
            *(weights * rate - state[2:] / times),
        ]

    def leaves(_t, state):
        return total(state)

    leaves.terminal, leaves.direction = True, -1.0
    speed, branches = np.sqrt(2.0 * GRAVITY * 50e-3) * 1e3, np.zeros(len(weights))
    place, spans, flights, peaks = 0.0, [], [], []
    for _ in range(contacts):
        start = [place, speed, *branches]
        end = solve_ivp(
            touching, (0.0, 0.5), start, events=leaves, rtol=1e-8, atol=1e-9, max_step=2e-4
        )
        spans.append(end.t[-1])
        peaks.append(max(total(state) for state in end.y.T))
        place, speed = end.y[0, -1], end.y[1, -1]
        # In flight the skin comes back without load: its elastic force balances its branches.
        flight, place, speed, branches = _fly(law, prony, end.y[:, -1])
        flights.append(flight)
    return np.array(spans), np.array(flights), np.array(peaks)


def _fly(law, prony, state):
    """Return length of a flight, and place, speed and branch forces at landing."""
    weights, times = np.array(prony.weights), np.array(prony.times_s)

    def free(_t, s):
        # elastic + sum of branches stays 0; with elastic' = u each branch has h' = g u - h / tau.
        u = np.sum(s[2:] / times) / (1.0 + weights.sum())
        return [s[1], 1e3 * GRAVITY, *(weights * u - s[2:] / times)]

    def lands(_t, s):
        return s[0] - law.depth_at(max(-s[2:].sum(), 0.0))

    lands.terminal, lands.direction = True, 1.0
    end = solve_ivp(free, (0.0, 0.5), state, events=lands, rtol=1e-8, atol=1e-9, max_step=5e-4)
    return end.t[-1], end.y[0, -1], end.y[1, -1], end.y[2:, -1]


@pytest.fixture(scope='module', params=[11, 13])
def both(request):
    device = draw_device(request.param, PAPER)
    law = device.law(WEIGHT_20_G)
    return simulated(law, device.prony, 2.5), integrated(law, device.prony, 6)


def test_contacts_and_flights_are_those_of_the_oracle(both):
    (landings, leavings, path), (spans, flights, peaks) = both
    np.testing.assert_allclose(leavings[:6] - landings[:6], spans, atol=2.5e-4)
    np.testing.assert_allclose(landings[1:7] - leavings[:6], flights, rtol=0.01, atol=2.5e-4)
    steps = (1e6 * np.stack([landings, leavings]) / STEP_US).round().astype(int)
    found = [path.force_n[a:b].max() for a, b in steps.T[:6]]
    np.testing.assert_allclose(found, peaks, rtol=0.01)


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
