# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The way from the events to the increments: live as in batches, with it and without."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from mixtac_fger.config import FgerConfig
from mixtac_fger.recurrent_network import RecurrentPath
from mixtac_fger.shear import ShearHead
from mixtac_learning.network import FgerNetwork, FrameSlots, arrays_of

WINDOWS = 60


@pytest.mark.parametrize('shortcut', [False, True])
def test_live_and_batch_agree(shortcut):
    torch.manual_seed(2)
    network = FgerNetwork(FgerConfig(event_shortcut=shortcut)).eval()
    events = torch.randn(WINDOWS, 1, network.config.grid_rows, network.config.grid_columns, 4)
    none = torch.full((WINDOWS, 1), -1)
    with torch.no_grad():
        course = network(
            events,
            torch.zeros(1, network.config.feature_size),
            FrameSlots(none, torch.zeros_like(none)),
            network.initial_state(1),
        )
        deviation = network.deviation(course.hidden, course.force, course.moved)
    path = RecurrentPath(network.config, arrays_of(network))
    live = []
    for window in events[:, 0].numpy():
        path.step(window)
        live.append((path.force, path.deviation))
    assert np.abs(np.array(live) - torch.cat([course.force, deviation], 1).numpy()).max() < 1e-5


def test_a_strong_burst_moves_the_force_at_once_only_with_the_shortcut():
    """The recurrent state is bounded, and what MLP_df makes of it is as well."""
    steps = {}
    for shortcut in (False, True):
        torch.manual_seed(3)
        network = FgerNetwork(FgerConfig(event_shortcut=shortcut)).eval()
        sizes = []
        for strength in (1e2, 1e4):
            path = RecurrentPath(network.config, arrays_of(network))
            path.step(np.full((6, 8, 4), strength, np.float32))
            sizes.append(abs(path.force))
        steps[shortcut] = sizes[1] / sizes[0]
    assert steps[False] < 2.0
    assert steps[True] > 20.0


def test_frames_show_the_same_sideways_force_live_as_in_batches():
    torch.manual_seed(5)
    network = FgerNetwork(FgerConfig(shear=True)).eval()
    frames = torch.rand(4, network.config.feature_size)
    head = ShearHead(network.config, arrays_of(network))
    with torch.no_grad():
        known = network.shear.shown(frames).numpy()
    for frame, value in zip(frames.numpy(), known, strict=True):
        np.testing.assert_allclose(head.measure(frame).value, value, atol=2e-5)


def test_a_path_can_begin_at_a_force():
    torch.manual_seed(4)
    network = FgerNetwork(FgerConfig()).eval()
    path = RecurrentPath(network.config, arrays_of(network))
    path.step(np.ones((6, 8, 4), np.float32))
    path.start_at(0.7)
    assert path.force == pytest.approx(0.7)
    feature = np.linspace(0.0, 1.0, network.config.feature_size, dtype=np.float32)
    with torch.no_grad():
        inputs = torch.cat([torch.tensor([0.7]), torch.from_numpy(feature)])
        change = float(network.correction(inputs)[0])
    # Any past is at that force as well.
    path.correct(feature, 20)
    assert path.force == pytest.approx(0.7 + change, abs=1e-5)
