# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Constants of the forces of frames and gains of sensors, fitted to made-up frames."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from mixtac_fger.config import MOMENTS, FgerConfig
from mixtac_learning.network import FgerNetwork
from mixtac_learning.train.frame_fit import Frames, fit_constants, fit_frames, fit_with_gains

GAINS = np.array([[0.5, 2.0], [1.0, 1.0], [2.0, 0.5]])
"""Gains of the normal and of the sideways force of three sensors."""


@pytest.fixture
def frames() -> Frames:
    random = np.random.default_rng(1)
    moments = random.normal(size=(6000, MOMENTS)) * np.linspace(1.0, 30.0, MOMENTS)
    sensor = np.arange(6000) % 3
    force = GAINS[sensor, 0] * (moments[:, :3] @ [0.5, -0.01, 0.1])
    pulls = [0.3 * moments[:, 3 + axis] - 0.1 * moments[:, 5 + axis] for axis in range(2)]
    torsion = moments[:, -4:] @ [0.0, 0.2, 0.1, 0.0]
    across = GAINS[sensor, 1, None] * np.stack([*pulls, torsion], 1)
    across[::7] = np.nan
    # Some labels are wholly wrong.
    force[::100] += 5.0
    return Frames(moments, force, across, sensor)


def test_constants_and_gains_are_found_in_spite_of_wrong_labels(frames):
    network = FgerNetwork(FgerConfig(shear=True))
    gains = fit_frames(network, frames)
    np.testing.assert_allclose(gains, GAINS, rtol=0.05)
    spread = network.frame.spread
    torch.testing.assert_close(
        torch.cat([network.frame.press / spread[:3], network.shear.pull / spread[[3, 5]]]),
        torch.tensor([0.5, -0.01, 0.1, 0.3, -0.1]),
        rtol=0.05,
        atol=0.0,
    )
    found, known = network.shear.turning / spread[-4:], torch.tensor([0.0, 0.2, 0.1, 0.0])
    torch.testing.assert_close(found, known, rtol=0.0, atol=0.005)


def test_an_adapted_network_keeps_all_but_its_press(frames):
    network = FgerNetwork(FgerConfig(shear=True))
    fit_frames(network, frames)
    before = {name: tensor.clone() for name, tensor in network.state_dict().items()}
    own = frames.sensor == 2
    lab = Frames(
        *(getattr(frames, name)[own] for name in Frames.__slots__[:3]), np.zeros(2000, int)
    )
    assert torch.equal(fit_frames(network, lab, adapts=True), torch.ones(1, 2))
    after = network.state_dict()
    assert [name for name in after if not torch.equal(after[name], before[name])] == ['frame.press']
    torch.testing.assert_close(after['frame.press'], 2.0 * before['frame.press'], rtol=0.05, atol=0)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 999), scale=st.floats(0.3, 3.0))
def test_constants_are_those_of_least_squares_where_errors_are_small(seed, scale):
    random = np.random.default_rng(seed)
    inputs, noise = random.normal(size=(500, 3)), 1e-3 * random.normal(size=500)
    values = scale * inputs @ [1.0, -2.0, 0.5] + noise
    expected = np.linalg.lstsq(inputs, values)[0]
    np.testing.assert_allclose(fit_constants(inputs, values), expected, rtol=1e-4, atol=1e-4)


def test_a_sensor_without_forces_has_a_gain_of_one():
    inputs = np.random.default_rng(2).normal(size=(1000, 1))
    sensor = np.repeat([0, 1], 500)
    values = np.where(sensor == 0, inputs[:, 0], 0.0)
    inputs[500:] = 0.0
    assert fit_with_gains(inputs, values, sensor)[1] == pytest.approx([1.0, 1.0], abs=1e-3)
