# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Contact in time: a free fall against its balance of momentum, and commanded contacts."""

import numpy as np
import pytest

from mixtac_sim.grids import STEP_US
from mixtac_sim.mechanics.contact import GRAVITY, Contact, Mode, PronySeries
from mixtac_sim.mechanics.elastomer import HEMISPHERE, WEIGHT_20_G, Layer, force_law

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


@pytest.fixture(scope='module')
def fall():
    return run(4.0, Mode.DROP, 50.0, tool=1)


def contacts(force):
    """Return first and last step of each contact."""
    edges = np.diff(np.concatenate([[0], force > 0.0, [0]]).astype(int))
    return np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)


def test_fall_takes_its_time(fall):
    first, _ = contacts(fall.force_n)
    assert first[0] * STEP_S == pytest.approx(np.sqrt(2.0 * 0.05 / GRAVITY), abs=2 * STEP_S)


def test_impulse_is_the_change_of_momentum(fall):
    first, last = contacts(fall.force_n)
    impulse = np.sum(fall.force_n[first[0] : last[0]]) * STEP_S
    arriving = np.sqrt(2.0 * GRAVITY * 0.05)
    flight = (first[1] - last[0]) * STEP_S
    weight = 0.02 * GRAVITY * (last[0] - first[0]) * STEP_S
    leaving = 0.5 * GRAVITY * flight
    # The body leaves a dented skin a little below where it lands: 1 % of the speed.
    assert impulse - weight == pytest.approx(0.02 * (arriving + leaving), rel=0.01)


def test_weight_comes_to_rest(fall):
    np.testing.assert_allclose(fall.force_n[-800:], 0.02 * GRAVITY, rtol=0.01)


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


def test_advancing_in_pieces_is_advancing_at_once():
    whole = run(0.4, Mode.DROP, 20.0, tool=1)
    body = contact()
    pieces = [run(0.1, Mode.DROP, 20.0, tool=1, body=body).force_n for _ in range(4)]
    np.testing.assert_array_equal(np.concatenate(pieces), whole.force_n)
