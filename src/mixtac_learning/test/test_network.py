# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The small network: the compiled one against torch, and its size by torch's own counter."""

from __future__ import annotations

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
from mixtac_fger.force_path import ForcePath, Shown
from mixtac_learning.network import FgerNetwork, FrameSlots, arrays_of

WINDOWS = 60


def test_live_and_batch_agree():
    torch.manual_seed(2)
    network = FgerNetwork(FgerConfig()).eval()
    events = torch.randn(WINDOWS, 1, network.config.grid_rows, network.config.grid_columns, 4)
    none = torch.full((WINDOWS, 1), -1)
    with torch.no_grad():
        force, _ = network(
            events,
            torch.zeros(1, MOMENTS),
            FrameSlots(none, torch.zeros_like(none)),
            network.initial_state(1),
        )
    path = ForcePath(network.config, arrays_of(network))
    path.gains.value = np.array([1.0, 0.0])
    live = []
    for window in events[:, 0].numpy():
        path.step(window)
        live.append(path.value[0])
    assert np.abs(np.array(live) - force[:, 0].numpy()).max() < 1e-5


def test_a_path_can_begin_at_a_force():
    torch.manual_seed(4)
    network = FgerNetwork(FgerConfig()).eval()
    path = ForcePath(network.config, arrays_of(network))
    path.step(np.ones((6, 8, 4), np.float32))
    shown = [Shown(np.zeros(MOMENTS), np.array([n]), np.zeros((1, 6, 8, 2))) for n in (0.7, 0.9)]
    path.start_at(shown[0])
    assert path.value[0] == pytest.approx(0.7)
    # Any past is at that force as well.
    path.correct(shown[1], 20)
    assert path.value[0] == pytest.approx(0.9)


MOST_PARAMETERS = 50_000
MOST_OPERATIONS = 5_000_000
WINDOWS_PER_FRAME = 20
"""Windows of 2 ms per frame interval of 40 ms."""


@pytest.mark.parametrize('config', [FgerConfig(), FgerConfig(lstm_size=7, shear=True)])
def test_shapes_without_torch_are_those_of_the_network(config):
    network = FgerNetwork(config)
    shapes = {name: tuple(tensor.shape) for name, tensor in network.state_dict().items()}
    assert tensor_shapes(config) == shapes
    fitted = sum(
        tensor.numel()
        for name, tensor in network.state_dict().items()
        if name in {'frame.press', 'shear.pull', 'shear.turning'}
    )
    assert count_parameters(config) == fitted + sum(p.numel() for p in network.parameters())


def test_fewer_parameters_and_operations_than_promised():
    assert count_parameters(FgerConfig()) < MOST_PARAMETERS
    assert operations_per_cycle(FgerConfig(shear=True)) < MOST_OPERATIONS
    network = FgerNetwork(FgerConfig())
    config = network.config
    events = torch.zeros(WINDOWS_PER_FRAME, 1, config.grid_rows, config.grid_columns, 4)
    slots = FrameSlots(
        torch.full((WINDOWS_PER_FRAME, 1), -1),
        torch.zeros((WINDOWS_PER_FRAME, 1), dtype=torch.int64),
    )
    slots.frame[0] = 0
    with FlopCounterMode(display=False) as counter, torch.no_grad():
        network(events, torch.zeros(1, MOMENTS), slots, network.initial_state(1))
    # In batches each window has what its frame adds; live it is computed once.
    again = 2 * (WINDOWS_PER_FRAME - 1) * network.context.weight.numel()
    counted = counter.get_total_flops() - again
    # Biases, and the moments of the flow, are operations for us and none for torch.
    assert counted <= operations_per_cycle(config) < 1.1 * counted
