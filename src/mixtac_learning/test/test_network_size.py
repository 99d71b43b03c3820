# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The small network is as small as it is said to be, counted by torch's own counter."""

from __future__ import annotations

from dataclasses import replace

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
from mixtac_learning.network import FgerNetwork, FrameSlots

MOST_PARAMETERS = 50_000
MOST_OPERATIONS = 5_000_000
WINDOWS = 20
"""Windows of 2 ms per frame interval of 40 ms."""


def test_fewer_parameters_than_promised():
    assert count_parameters(FgerConfig()) < MOST_PARAMETERS


@pytest.mark.parametrize(
    'config',
    [
        FgerConfig(),
        FgerConfig(event_shortcut=False, deviation_size=0),
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


def test_fewer_operations_than_promised():
    assert operations_per_cycle(FgerConfig(shear=True)) < MOST_OPERATIONS
    # In batches each window has what its frame adds; live it is computed once.
    network = FgerNetwork(FgerConfig(frame_context=False))
    config = network.config
    frame = torch.zeros(1, len(config.frame_channels), *config.frame_shape)
    events = torch.zeros(WINDOWS, 1, config.grid_rows, config.grid_columns, 4)
    slots = FrameSlots(torch.full((WINDOWS, 1), -1), torch.zeros((WINDOWS, 1), dtype=torch.int64))
    slots.frame[0] = 0
    with FlopCounterMode(display=False) as counter, torch.no_grad():
        features = network.frame(frame, torch.zeros(1, MOMENTS))
        course = network(events, features, slots, network.initial_state(1))
        network.deviation(course.hidden, course.force, course.moved)
    counted = counter.get_total_flops()
    # Biases are operations for us and none for torch.
    assert counted <= operations_per_cycle(config) < 1.05 * counted
