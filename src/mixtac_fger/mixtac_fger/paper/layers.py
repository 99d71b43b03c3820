# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Layers shared by the paper's networks: residual backbone, point network, perceptron."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn

if TYPE_CHECKING:
    from mixtac_fger.paper.config import PaperConfig

POINT_SIZE = 4
"""Numbers per event: x, y, time in the packet, polarity; each within -1 .. 1."""


class ResidualBlock(nn.Module):
    """Two 3 x 3 convolutions with a bypass (He et al. 2016).

    Args:
        channels: Of input and output.
    """

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(channels, channels, 3, padding=1, bias=False)
        self.first_norm = nn.BatchNorm2d(channels)
        self.second = nn.Conv2d(channels, channels, 3, padding=1, bias=False)
        self.second_norm = nn.BatchNorm2d(channels)

    def forward(self, maps: Tensor) -> Tensor:
        """Return maps of the same shape, [N, channels, rows, columns]."""
        inner = torch.relu(self.first_norm(self.first(maps)))
        return torch.relu(maps + self.second_norm(self.second(inner)))


class FrameBackbone(nn.Module):
    """Phi_f: stem and first stage of a residual network, then the average over the image.

    Args:
        config: Shapes.
    """

    def __init__(self, config: PaperConfig) -> None:
        super().__init__()
        self.mean: Tensor
        self.deviation: Tensor
        self.register_buffer('mean', torch.zeros(1))
        self.register_buffer('deviation', torch.ones(1))
        channels = config.channels
        self.stem = nn.Sequential(
            nn.Conv2d(1, channels, 7, stride=2, padding=3, bias=False),
            nn.BatchNorm2d(channels),
            nn.ReLU(),
            nn.MaxPool2d(3, stride=2, padding=1),
        )
        self.stage = nn.Sequential(*(ResidualBlock(channels) for _ in range(config.blocks)))

    def forward(self, frames: Tensor) -> Tensor:
        """Return f_frame [N, channels] of intensities [N, 1, rows, columns]."""
        maps = self.stage(self.stem((frames - self.mean) / self.deviation))
        return torch.Tensor(maps.mean((2, 3)))


class PointEncoder(nn.Module):
    """Phi_e: a perceptron on every event, then the maximum over each packet.

    Args:
        config: Shapes.
    """

    def __init__(self, config: PaperConfig) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        width = POINT_SIZE
        for size in config.event_widths:
            layers += [nn.Linear(width, size), nn.ReLU()]
            width = size
        self.layers = nn.Sequential(*layers)
        self.size = width

    def forward(self, points: Tensor, packet: Tensor, packets: int) -> Tensor:
        """Return f_e [packets, size]; zeros for an empty packet.

        Args:
            points: All events of all packets, [E, 4].
            packet: Which packet each belongs to, int64 [E].
            packets: How many packets.
        """
        features = self.layers(points)
        empty = features.new_zeros(packets, self.size)
        # After a rectifier nothing is below zero, so that zeros leave the maximum as it is.
        index = packet[:, None].expand(-1, self.size)
        pooled = empty.scatter_reduce(0, index, features, 'amax', include_self=True)
        return torch.Tensor(pooled)


def perceptron(inputs: int, hidden: int) -> nn.Sequential:
    """Return a perceptron with one hidden layer and one output."""
    return nn.Sequential(nn.Linear(inputs, hidden), nn.ReLU(), nn.Linear(hidden, 1))
