# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""An indenter pulled and turned on the skin, against solutions of its own."""

import numpy as np
import pytest

from mixtac_sim.mechanics.contact import ContactPath, PronySeries
from mixtac_sim.mechanics.elastomer import Layer, Shear
from mixtac_sim.mechanics.sliding import SLIDING_MM_S, Sliding
from mixtac_sim.world.segments import still

LAYER, RADIUS, MU = Layer(150.0, 4.0), 2.5, 0.6
SHEAR_MODULUS = 0.05  # MPa
ELASTIC = PronySeries((), ())


def path(force_n):
    zero = np.zeros(len(force_n))
    return ContactPath(np.asarray(force_n, np.float64), zero, zero, zero)


def moved(steps, force_n=0.8, radius=RADIUS, *, prony=ELASTIC, layer=LAYER, mu=MU, partial=True):
    """Return what motion steps [n, 3] do under a force that is constant unless it is a series.

    Steps of five columns roll as well, those of seven are pulled.
    """
    sliding = Sliding(Shear(layer, mu, (0.0, 0.0), partial_slip=partial), prony)
    force = np.broadcast_to(force_n, len(steps))
    all_steps = still(len(steps))
    all_steps[:, : np.shape(steps)[1]] = steps
    return sliding.advance(all_steps, path(force), np.full(len(steps), radius))


def along(axis, way, count=200):
    steps = np.zeros((count, 3))
    steps[:, axis] = way / count
    return steps


def disc_on_layer(alpha):
    """Return the tangential stiffness of a disc over G times its radius, on a bonded layer.

    Energy of the pressure of a disc on a half-space, over all waves: along the pull the layer is
    (sinh 2t + 2t) / (cosh 2t + 1 + 2 t^2) / 2 as soft as across it, where it is tanh t.
    """
    t = np.linspace(1e-4, 400.0, 400_001)
    u = np.minimum(t, 20.0)
    soft = (np.sinh(2 * u) + 2 * u) / (np.cosh(2 * u) + 1 + 2 * u * u) / 4 + np.tanh(u) / 2
    rest = 0.75 * 0.5 / (alpha**2 * t[-1])
    integral = float(np.sum(soft * np.sinc(alpha * t / np.pi) ** 2) * (t[1] - t[0])) + rest
    return 2.0 * np.pi / integral / alpha


def turned_disc_on_layer(alpha):
    """Return the stiffness of a disc against a turn over that on a half-space, on a bonded layer.

    Fredholm equation of the dual integrals with the layer's tanh(t).
    """
    x, weights = (0.5 * each for each in np.polynomial.legendre.leggauss(96))
    x += 0.5
    t, t_weights = (15.0 * each for each in np.polynomial.legendre.leggauss(256))
    t += 15.0
    waves = np.sin(alpha * np.outer(x, t))
    kernel = 2.0 * alpha / np.pi * (waves * t_weights * (1.0 - np.tanh(t))) @ waves.T
    found = np.linalg.solve(np.eye(len(x)) - kernel * weights, x)
    return 3.0 * float(np.sum(weights * found * x))


@pytest.mark.parametrize('alpha', [0.4, 0.6, 1.0, 1.5])
def test_a_stuck_contact_is_as_stiff_as_a_disc_on_a_bonded_layer(alpha):
    radius = alpha * LAYER.thickness_mm
    pulled = moved(along(0, 1e-4), 100.0, radius, partial=False).pull_n[-1, 0] / 1e-4
    assert pulled == pytest.approx(SHEAR_MODULUS * radius * disc_on_layer(alpha), rel=0.15)
    if alpha <= 1.0:
        turned = 1e3 * moved(along(2, 1e-4), 100.0, radius, partial=False).torque_nm[-1] / 1e-4
        exact = 16.0 / 3.0 * SHEAR_MODULUS * radius**3 * turned_disc_on_layer(alpha)
        assert turned == pytest.approx(exact, rel=0.07)


def test_partial_slip_leaves_the_circle_of_cattaneo_and_mindlin_stuck():
    found = moved(along(1, 1.2))
    stiffness = Shear(LAYER, MU, (0.0, 0.0)).stiffness(np.array([RADIUS]))[0]
    whole = 1.5 * MU * 0.8 / stiffness
    way = np.arange(1, 201) * 1.2 / 200
    stuck = np.sqrt(np.maximum(1.0 - way / whole, 0.0))  # radius of the circle over the contact's
    np.testing.assert_allclose(found.pull_n[:, 1], MU * 0.8 * (1.0 - stuck**3), rtol=1e-9)
    np.testing.assert_allclose(found.shear_mm[:, 1], found.pull_n[:, 1] / stiffness, rtol=1e-9)
    # What the skin does not follow any more is slid.
    np.testing.assert_allclose(found.place_mm[:, 1], way - np.minimum(way, whole), atol=1e-9)
    assert not found.pull_n[:, 0].any()


def test_a_roll_moves_the_contact_and_pulls_at_nothing():
    steps = np.zeros((600, 5))
    steps[:200, 0] = 0.2 / 200  # pulled, then rolled, then pulled back
    steps[200:400, 4] = -2.0 / 200
    steps[400:, 0] = -0.2 / 200
    found = moved(steps, 5.0)
    np.testing.assert_allclose(found.pull_n[200:400], found.pull_n[199:200].repeat(200, axis=0))
    assert found.place_mm[399, 1] == pytest.approx(-2.0)
    assert found.pull_n[-1, 0] == pytest.approx(0.0, abs=1e-9)


def test_friction_bears_the_torque_of_a_hertzian_pressure():
    r = (np.arange(20_000) + 0.5) / 20_000 * RADIUS
    pressure = 1.5 * 0.8 / (np.pi * RADIUS**2) * np.sqrt(1.0 - (r / RADIUS) ** 2)
    largest = 1e-3 * float(np.sum(MU * pressure * r * 2.0 * np.pi * r) * RADIUS / 20_000)
    for partial in (True, False):
        found = moved(along(2, -1.0), partial=partial)
        assert found.torque_nm[-1] == pytest.approx(-largest, rel=1e-4)
        assert np.all(np.diff(found.torque_nm) <= 1e-12)
    gentle = moved(along(2, 1e-3))
    stiffness = 16.0 / 3.0 * SHEAR_MODULUS * RADIUS**3
    assert 1e3 * gentle.torque_nm[-1] == pytest.approx(stiffness * 1e-3, rel=0.01)
    np.testing.assert_allclose(1e3 * gentle.torque_nm, stiffness * gentle.turn_rad, rtol=1e-9)


def test_a_pull_relaxes_and_a_released_skin_creeps_back():
    prony = PronySeries((0.2,), (0.02,))
    pulled = along(0, 0.05, 40)
    still = np.zeros((4000, 3))
    force = np.full(8040, 100.0)
    force[4040:] = 0.0
    found = moved(np.concatenate([pulled, still, still]), force, prony=prony, partial=False)
    stiffness = Shear(LAYER, MU, (0.0, 0.0)).stiffness(np.array([RADIUS]))[0]
    held = found.pull_n[40:4040, 0]
    assert held[0] > 1.1 * held[-1]
    assert held[-1] == pytest.approx(stiffness * 0.05, rel=1e-6)
    free = found.shear_mm[4040:, 0]
    assert not found.pull_n[4040:].any()
    # At once by the relaxed share, then with the retardation time (1 + g) tau.
    assert free[0] == pytest.approx(0.05 * 0.2 / 1.2, rel=0.02)
    assert free[192] == pytest.approx(free[0] / np.e, rel=0.01)


def test_a_contact_is_where_the_indenter_touches():
    steps = np.concatenate([along(0, 3.0), along(0, -3.0), along(0, 0.0)])
    force = np.repeat([0.8, 0.0, 0.8], 200)
    found = moved(steps, force)
    assert found.place_mm[199, 0] == pytest.approx(3.0 - found.shear_mm[199, 0], abs=0.35)
    # In the air the dent stays; the next contact is where the indenter is then.
    assert np.ptp(found.place_mm[200:400, 0]) == 0.0
    assert found.place_mm[-1, 0] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize('partial', [True, False])
def test_a_force_pulls_the_skin_as_far_as_the_way_that_takes_this_force(partial):
    pull = np.zeros((2000, 7))
    # To three quarters of the friction along a slant, then held while the gel creeps.
    rise = np.minimum(np.arange(2000) / 1000, 1.0) * 0.75 * MU * 0.8
    pull[:, 5], pull[:, 6] = 0.6 * rise, -0.8 * rise
    prony = PronySeries((0.2,), (0.02,))
    found = moved(pull, prony=prony, partial=partial)
    np.testing.assert_allclose(found.pull_n, pull[:, 5:], atol=1e-9)
    crept = np.hypot(*found.shear_mm.T)
    assert crept[1999] > crept[1000] > 0.0
    # Moved by as much as the force moved it, the skin pulls back as much.
    way = np.zeros((2000, 3))
    way[:, :2] = np.diff(found.place_mm + found.shear_mm, axis=0, prepend=0.0)
    if not partial:
        back = moved(way, prony=prony, partial=partial)
        np.testing.assert_allclose(back.pull_n, found.pull_n, atol=1e-6)
    # Let go of the thread, the contact is free.
    free = moved(np.concatenate([pull, np.zeros((200, 7))]), prony=prony, partial=partial)
    assert np.abs(free.pull_n[2000:]).max() < 1e-12


def test_a_force_beyond_friction_slides_and_pulls_at_the_friction():
    pull = np.zeros((1500, 7))
    pull[:, 5] = 2.0 * MU * 0.8
    found = moved(pull)
    assert found.pull_n[-1] == pytest.approx([MU * 0.8, 0.0])
    assert np.diff(found.place_mm[1300:, 0]) == pytest.approx(SLIDING_MM_S * 125e-6)
    # In the air nothing holds it, and it stays where it was.
    off = moved(pull, np.zeros(1500))
    assert not off.pull_n.any()
    assert not off.place_mm.any()
