# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The mount's ringing against a state-space simulation, and what the inertial unit feels of it."""

import numpy as np
import pytest
from scipy.signal import cont2discrete, dlsim

from mixtac_sim.world.effects import EASY, preset
from mixtac_sim.world.instruments import InertialUnit, Mount, ReferenceSensor

T_US = np.arange(1, 8_001) * 125


def blow(start_us=100_000, length_us=5_000, force=10.0):
    wrench = np.zeros((len(T_US), 6))
    since = T_US - start_us
    inside = (since > 0) & (since <= length_us)
    wrench[inside, 2] = force * np.sin(np.pi * since[inside] / length_us)
    return wrench


def simulated(resonance_hz, damping, force):
    """Return force passed on and m times acceleration of a damped oscillator, by scipy."""
    w = 2.0 * np.pi * resonance_hz
    a, b = [[0.0, 1.0], [-w * w, -2.0 * damping * w]], [[0.0], [w * w]]
    c, d = [[1.0, 0.0], [-1.0, -2.0 * damping / w]], [[0.0], [1.0]]
    system = cont2discrete(tuple(map(np.array, (a, b, c, d))), 125e-6, 'zoh')
    _, _, state = dlsim(system, np.append(force, 0.0))
    arrived, speed = state[1:].T
    return arrived, force - arrived - 2.0 * damping / w * speed


@pytest.mark.parametrize(('resonance', 'damping'), [(250.0, 0.05), (900.0, 0.02)])
def test_ringing_is_that_of_a_damped_oscillator(resonance, damping):
    wrench = blow()
    arrived, left = Mount(resonance, damping).swing(T_US, wrench)
    force, shaken = simulated(resonance, damping, wrench[:, 2])
    np.testing.assert_allclose(arrived[:, 2], force, atol=1e-8)
    np.testing.assert_allclose(left[:, 2], shaken, atol=1e-8)
    assert np.abs(arrived[:, :2]).max() == 0.0


def test_steady_forces_pass_unchanged():
    wrench = np.ones((len(T_US), 6))
    arrived, _ = Mount(400.0, 0.05).swing(T_US, wrench)
    np.testing.assert_allclose(arrived[-1], 1.0, atol=1e-6)
    assert Mount(0.0, 0.05).swing(T_US, wrench)[0] is wrench


def test_pieces_give_what_the_whole_gives():
    wrench, mount = blow(), Mount(300.0, 0.03)
    parts = [mount.swing(T_US[a : a + 37], wrench[a : a + 37])[0] for a in range(0, 8_000, 37)]
    whole, _ = Mount(300.0, 0.03).swing(T_US, wrench)
    np.testing.assert_allclose(np.concatenate(parts), whole, atol=1e-12)


def test_reference_rings_after_an_impact_where_asked_to():
    loose = preset('hard').without('timing')

    def after(chosen):
        samples = ReferenceSensor(2, preset=chosen).process(T_US, blow())
        late = (samples.t_ns > 110_000_000) & (samples.t_ns < 160_000_000)
        return samples.wrench[late, 2]

    assert np.abs(after(loose)).max() > 0.04
    assert np.abs(after(loose.without('impact'))).max() < 0.011


def test_inertial_unit_feels_an_impact_and_nothing_before():
    still, struck = InertialUnit(4), InertialUnit(4)
    struck.feel(T_US, blow())
    before, after = (
        np.array([r.acceleration_g for r in u.readings(1_000_000, 1_000)]) for u in (still, struck)
    )
    felt = after - before
    assert np.abs(felt[:99]).max() == 0.0
    assert 0.05 < np.abs(felt[100:110]).max() < 8.0
    assert np.abs(felt[:, :2]).max() == 0.0
    # What is struck comes to rest again: no velocity is left.
    assert abs(felt[:, 2].sum()) < 0.2 * np.abs(felt[:, 2]).sum()
    assert EASY.impact.ringing_hz == (0.0, 0.0)
