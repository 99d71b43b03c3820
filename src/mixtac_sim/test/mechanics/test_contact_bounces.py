# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A dropped weight against an independent integration of the same layer with Maxwell branches.

The oracle is scipy's: positions and branch forces as one system of ordinary differential
equations with events at take-off and landing. It shares nothing with the simulator but the
elastic force of a depth and the constants of the branches.
"""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from mixtac_sim.grids import STEP_US
from mixtac_sim.mechanics.contact import GRAVITY, Contact, Mode
from mixtac_sim.mechanics.elastomer import WEIGHT_20_G, force_law
from mixtac_sim.world.device import draw_device
from mixtac_sim.world.effects import preset

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
    law = force_law(device.layer, WEIGHT_20_G, device.mesh_n_per_mm, device.stiffening)
    return simulated(law, device.prony, 2.5), integrated(law, device.prony, 6)


def test_contacts_and_flights_are_those_of_the_oracle(both):
    (landings, leavings, path), (spans, flights, peaks) = both
    np.testing.assert_allclose(leavings[:6] - landings[:6], spans, atol=2.5e-4)
    np.testing.assert_allclose(landings[1:7] - leavings[:6], flights, rtol=0.01, atol=2.5e-4)
    steps = (1e6 * np.stack([landings, leavings]) / STEP_US).round().astype(int)
    found = [path.force_n[a:b].max() for a, b in steps.T[:6]]
    np.testing.assert_allclose(found, peaks, rtol=0.01)
