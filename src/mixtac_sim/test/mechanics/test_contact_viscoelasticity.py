# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The closed update against the convolution it stands for."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixtac_sim.mechanics.contact import PronySeries, force_terms, relax

SERIES = PronySeries((0.3, 0.1, 0.05), (0.002, 0.05, 2.0))


def respond(elastic, step_s, series=SERIES):
    """Return the force of a path of elastic forces."""
    update, branches, last, forces = series.update(step_s), np.zeros(len(series.weights)), 0.0, []
    for value in elastic:
        carried, gain = force_terms(branches, update, last)
        forces.append(carried + gain * value)
        relax(branches, update, value - last)
        last = value
    return np.array(forces)


def convolve(elastic_at, end_s, series=SERIES):
    """Return the force at one time as the hereditary integral, by brute force."""
    s = np.linspace(0.0, end_s, 200_001)
    middle = 0.5 * (s[1:] + s[:-1])
    kernel = 1.0 + sum(
        g * np.exp(-(end_s - middle) / t)
        for g, t in zip(series.weights, series.times_s, strict=True)
    )
    return float(np.sum(kernel * np.diff(elastic_at(s))))


def test_update_is_the_hereditary_integral():
    def path(t):
        return np.sin(3.0 * t) ** 2 * t

    step = 1e-3
    forces = respond(path(step * np.arange(1, 1001)), step)
    for k in (9, 99, 500, 999):
        assert forces[k] == pytest.approx(convolve(path, step * (k + 1)), rel=1e-3, abs=1e-6)


def loss_tangent(series, frequency_hz):
    """Return tan delta of a Prony series under a small sinusoid."""
    turn = 2j * np.pi * frequency_hz * np.array(series.times_s)
    modulus = 1.0 + np.sum(np.array(series.weights) * turn / (1.0 + turn))
    return modulus.imag / modulus.real


def test_loss_tangent_is_the_lag_of_a_sinusoid():
    frequency, step = 20.0, 1e-5
    t = step * np.arange(1, 100_001)
    force = respond(np.sin(2 * np.pi * frequency * t), step)[50_000:]
    wave = np.exp(2j * np.pi * frequency * t[50_000:])
    lag = np.angle(np.mean(force * wave)) - np.angle(np.mean(np.imag(wave) * wave))
    assert abs(np.tan(lag)) == pytest.approx(loss_tangent(SERIES, frequency), rel=0.01)


@settings(max_examples=50)
@given(
    st.lists(st.floats(0.0, 5.0), min_size=1, max_size=30),
    st.floats(1e-5, 0.1),
)
def test_force_control_inverts_depth_control(elastic, step_s):
    update = SERIES.update(step_s)
    forces = respond(np.array(elastic), step_s)
    branches, last = np.zeros(3), 0.0
    for wanted, force in zip(elastic, forces, strict=True):
        carried, gain = force_terms(branches, update, last)
        found = (force - carried) / gain
        assert found == pytest.approx(wanted, abs=1e-9)
        relax(branches, update, found - last)
        last = found
