# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The compiled frame network against torch."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import nn

from mixtac_fger.config import MOMENTS, FgerConfig, map_shapes
from mixtac_fger.frame_network import frame_maps, frame_step, frame_weights, row_scratch
from mixtac_learning.network import FrameNetwork, arrays_of

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


def test_shapes_are_those_of_torch():
    config = CONFIGS['odd sizes']
    network = FrameNetwork(config)
    maps = torch.zeros(1, len(config.frame_channels), *config.frame_shape)
    shapes = [tuple(maps.shape[i] for i in (2, 3, 1))]
    for layer in network.convolutions:
        maps = layer(maps)
        if isinstance(layer, nn.Conv2d):
            shapes.append(tuple(maps.shape[i] for i in (2, 3, 1)))
    assert map_shapes(config) == shapes
