# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The small network: the compiled one against torch, and its size by torch's own counter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch.utils.flop_counter import FlopCounterMode

from mixtac_fger.config import (
    MOMENTS,
    FgerConfig,
    count_parameters,
    operations_per_cycle,
    tensor_shapes,
)
from mixtac_fger.frame_network import frame_maps, frame_step, frame_weights, row_scratch
from mixtac_fger.recurrent_network import RecurrentPath
from mixtac_fger.shear import ShearHead
from mixtac_learning.network import FgerNetwork, FrameNetwork, FrameSlots, arrays_of

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
    path = RecurrentPath(network.config, arrays_of(network))
    path.gains.value = np.array([1.0, 0.0])
    live = []
    for window in events[:, 0].numpy():
        path.step(window)
        live.append(path.force)
    assert np.abs(np.array(live) - course.force[:, 0].numpy()).max() < 1e-5


def test_frames_show_the_same_sideways_force_live_as_in_batches():
    torch.manual_seed(5)
    network = FgerNetwork(FgerConfig(shear=True)).eval()
    frames = torch.rand(4, network.config.feature_size)
    head = ShearHead(network.config, arrays_of(network))
    per_flow = np.zeros((MOMENTS, *network.config.grid_shape, 2))
    with torch.no_grad():
        known = network.shear.shown(frames).numpy()
    for frame, value in zip(frames.numpy(), known, strict=True):
        np.testing.assert_allclose(head.measure(frame, per_flow).value, value, atol=2e-5)


def test_a_path_can_begin_at_a_force():
    torch.manual_seed(4)
    network = FgerNetwork(FgerConfig()).eval()
    path = RecurrentPath(network.config, arrays_of(network))
    path.step(np.ones((6, 8, 4), np.float32))
    path.start_at(0.7)
    assert path.force == pytest.approx(0.7)
    # Any past is at that force as well.
    assert path.correct(0.9, 20) == pytest.approx(0.2)


CONFIGS = {
    'default': FgerConfig(),
    'odd sizes': FgerConfig(height=130, width=202, frame_widths=(5, 7), frame_size=11),
    'five layers': FgerConfig(frame_widths=(4, 6, 8, 10, 12), frame_channels=('difference',)),
}


@pytest.mark.parametrize('name', CONFIGS)
def test_features_and_force_are_those_of_torch(name):
    config = CONFIGS[name]
    torch.manual_seed(3)
    network = FrameNetwork(config)
    network.mean.copy_(torch.randn_like(network.mean))
    network.scale.copy_(torch.rand_like(network.scale) + 0.1)
    if config.reads_flow:
        network.spread.copy_(torch.rand_like(network.spread) + 0.5)
    weights, maps, scratch = (
        frame_weights(
            {f'frame.{name}': value for name, value in arrays_of(network).items()}, config
        ),
        frame_maps(config),
        row_scratch(config),
    )
    random = np.random.default_rng(3)
    feature = np.full(config.feature_size, np.nan, np.float32)
    # Twice: what is left in the scratch memory must not matter.
    for _ in range(2):
        shape = (len(config.frame_channels), *config.frame_shape)
        inputs = random.normal(size=shape).astype(np.float32)
        moments = random.normal(size=MOMENTS if config.reads_flow else 0).astype(np.float32)
        force = frame_step(inputs, moments, weights, maps, scratch, feature)
        with torch.inference_mode():
            expected = network(torch.from_numpy(inputs)[None], torch.from_numpy(moments)[None])
            expected_force = network.force(expected)
        assert np.ptp(expected.numpy()) > 0.03
        assert feature == pytest.approx(expected[0].numpy(), abs=1e-5)
        assert force == pytest.approx(float(expected_force[0]), abs=1e-5)


MOST_PARAMETERS = 50_000
MOST_OPERATIONS = 5_000_000
WINDOWS_PER_FRAME = 20
"""Windows of 2 ms per frame interval of 40 ms."""


@pytest.mark.parametrize(
    'config',
    [
        FgerConfig(),
        FgerConfig(event_shortcut=False),
        FgerConfig(frame_widths=(4, 8), frame_channels=('flow_x', 'flow_y'), lstm_size=7),
    ],
)
def test_shapes_without_torch_are_those_of_the_network(config):
    network = FgerNetwork(config)
    shapes = {name: tuple(tensor.shape) for name, tensor in network.state_dict().items()}
    assert tensor_shapes(config) == shapes
    carried = FgerNetwork(replace(config, shear=True))
    names = set(carried.state_dict())
    assert names == set(tensor_shapes(carried.config))
    assert count_parameters(config) == sum(p.numel() for p in network.parameters())


def test_fewer_parameters_and_operations_than_promised():
    assert count_parameters(FgerConfig()) < MOST_PARAMETERS
    assert operations_per_cycle(FgerConfig(shear=True)) < MOST_OPERATIONS
    # In batches each window has what its frame adds; live it is computed once.
    network = FgerNetwork(FgerConfig(frame_context=False))
    config = network.config
    frame = torch.zeros(1, len(config.frame_channels), *config.frame_shape)
    events = torch.zeros(WINDOWS_PER_FRAME, 1, config.grid_rows, config.grid_columns, 4)
    slots = FrameSlots(
        torch.full((WINDOWS_PER_FRAME, 1), -1),
        torch.zeros((WINDOWS_PER_FRAME, 1), dtype=torch.int64),
    )
    slots.frame[0] = 0
    with FlopCounterMode(display=False) as counter, torch.no_grad():
        features = network.frame(frame, torch.zeros(1, MOMENTS))
        network(events, features, slots, network.initial_state(1))
    counted = counter.get_total_flops()
    # Biases are operations for us and none for torch.
    assert counted <= operations_per_cycle(config) < 1.05 * counted
