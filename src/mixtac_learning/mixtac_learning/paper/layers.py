# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Layers of the paper's networks: scales, frame network, point network, sparse convolutions."""

from __future__ import annotations

import math
from itertools import pairwise, product

import torch
from torch import Tensor, nn
from torch.nn.functional import max_pool2d

from mixtac_learning.paper.config import PaperConfig

POINT_SIZE = 4
"""Numbers per event: x, y, time in the packet, polarity; each within -1 .. 1."""


class Scale(nn.Module):
    """Brings values to zero mean and unit spread by constants that belong to the weights.

    The average over an image hardly moves: a feature varies by some thousandths of its mean over
    all forces. Without this, the layers behind need tens of epochs to find the variation.

    Args:
        size: Number of channels.

    Attributes:
        follows: Whether values are scaled by their own mean and spread in training, which the
            constants follow: where what computes them learns.
    """

    def __init__(self, size: int) -> None:
        super().__init__()
        self.mean: Tensor
        self.deviation: Tensor
        self.register_buffer('mean', torch.zeros(size))
        self.register_buffer('deviation', torch.ones(size))
        self.follows = False

    def reset(self) -> None:
        """Leave values as they are."""
        self.mean.zero_()
        self.deviation.fill_(1.0)

    def fit(self, values: Tensor, part: float = 1.0) -> tuple[Tensor, Tensor]:
        """Move the constants by a part towards the statistics of values [n, size]; return these.

        The spread of channels that are constant is 1.
        """
        mean, deviation = values.mean(0), values.std(0)
        varies = deviation > SAME * mean.abs() + SAME
        deviation = torch.where(varies, deviation, torch.ones_like(deviation))
        with torch.no_grad():
            self.mean.lerp_(mean, part)
            self.deviation.lerp_(deviation, part)
        return mean, deviation

    def forward(self, values: Tensor) -> Tensor:
        """Return values [n, size] scaled; in training by their own mean where `follows` is set."""
        values = values.float()
        mean, deviation = self.mean, self.deviation
        if self.follows and self.training and len(values) > 1:
            mean, deviation = self.fit(values, _FOLLOWED)
        return (values - mean) / deviation


_AT_RANDOM = 0.1
"""Part of the usual initial weights that is left where channels begin as cells."""
_BY_TIME = 0.5
"""Initial difference of a channel between the last and the first event of a packet."""
_FOLLOWED = 0.05
"""Part of the way that the constants of a scale go in an update."""
SAME = 1e-6
"""Relative spread below which a channel is constant."""


def _grid(ramps: int, channels: int) -> tuple[int, int]:
    """Return how many columns and rows of cells so many ramps and channels can make."""
    rows = max(math.isqrt(channels // 2), 1)
    columns = max(channels // 2 // rows, 1)
    while 2 * (columns + rows - 2) + 3 > ramps and max(columns, rows) > 1:
        columns, rows = (columns - 1, rows) if columns >= rows else (columns, rows - 1)
    return columns, rows


_GROUPS = 8
"""Groups of channels that are normalised together."""


def _norm(config: PaperConfig) -> nn.Module:
    """Return a normalisation of the frame network's maps; both kinds have as many parameters."""
    if config.norm == 'batch':
        return nn.BatchNorm2d(config.channels)
    return nn.GroupNorm(math.gcd(_GROUPS, config.channels), config.channels)


class ResidualBlock(nn.Module):
    """Two 3 x 3 convolutions with a bypass (He et al. 2016).

    Args:
        config: Shapes.
    """

    def __init__(self, config: PaperConfig) -> None:
        super().__init__()
        channels = config.channels
        self.first = nn.Conv2d(channels, channels, 3, padding=1, bias=False)
        self.first_norm = _norm(config)
        self.second = nn.Conv2d(channels, channels, 3, padding=1, bias=False)
        self.second_norm = _norm(config)

    def forward(self, maps: Tensor) -> Tensor:
        """Return maps of the same shape, [N, channels, rows, columns]."""
        inner = torch.relu(self.first_norm(self.first(maps)))
        return torch.relu(maps + self.second_norm(self.second(inner)))


DARK = 1e-3
"""Smallest intensity before the logarithm: the converter's lowest bit."""


class FrameBackbone(nn.Module):
    """Phi_f: stem and first stage of a residual network, then the average over the image.

    Args:
        config: Shapes.
    """

    def __init__(self, config: PaperConfig) -> None:
        super().__init__()
        self._relative = config.light != 'intensity'
        channels = config.channels
        self.input_scale, self.scale = Scale(1), Scale(channels)
        self.stem = nn.Sequential(
            nn.Conv2d(1, channels, 7, stride=2, padding=3, bias=False),
            _norm(config),
            nn.ReLU(),
            nn.MaxPool2d(3, stride=2, padding=1),
        )
        self.stage = nn.Sequential(*(ResidualBlock(config) for _ in range(config.blocks)))

    def seen(self, frames: Tensor) -> Tensor:
        """Return the frames as the network sees them, before they are scaled.

        Args:
            frames: Intensities of 0 to 1, or their ratio to the reference, [N, 1, rows, columns].

        Returns:
            The same with the channel last.
        """
        frames = frames.movedim(1, -1)
        if not self._relative:
            return frames
        logs = torch.log(frames.clamp(min=DARK))
        return logs - logs.mean((1, 2), keepdim=True)

    def forward(self, frames: Tensor) -> Tensor:
        """Return f_frame [N, channels] of the inputs of `seen`, in full precision.

        Features vary by no more than bfloat16 resolves.
        """
        with torch.autocast(frames.device.type, enabled=False):
            inputs = self.input_scale(self.seen(frames.float())).movedim(-1, 1)
            maps = self.stage(self.stem(inputs.contiguous(memory_format=torch.channels_last)))
            return torch.Tensor(self.scale(maps.mean((2, 3))))


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
        # The maximum begins at zero, which is the last rectifier.
        self.layers = nn.Sequential(*layers[:-1])
        self.size = width
        self.scale = Scale(width)
        if len(config.event_widths) > 1:
            self._begin_with_cells()

    @torch.no_grad()
    def _begin_with_cells(self) -> None:
        """Let channels begin as one cell of the sensor and one polarity each.

        A maximum shows only whether there was an event, so that a channel has to be of one place.
        With the usual initial weights every ramp is as wide as the sensor. The value grows with
        the time of the latest event, which is the later the more there are.
        """
        first, second = (self.layers.get_submodule(name) for name in ('0', '2'))
        ramps, ramp_bias = first.get_parameter('weight'), first.get_parameter('bias')
        sums, sum_bias = second.get_parameter('weight'), second.get_parameter('bias')
        cells = _grid(len(ramps), len(sums))
        # Ramps up and down from each border between cells; polarity ON, OFF; time.
        used, starts = 3, dict[tuple[int, float], int]()
        ramps[:3], ramp_bias[:3] = 0.0, 0.0
        ramps[0, 3], ramps[1, 3], ramps[2, 2] = 1.0, -1.0, 1.0
        for axis, count in enumerate(cells):
            borders = torch.linspace(-1.0, 1.0, count + 1)[1:-1]
            for sign in (1.0, -1.0):
                rows = slice(used, used + count - 1)
                ramps[rows], ramp_bias[rows] = 0.0, -sign * borders
                ramps[rows, axis] = sign
                starts[axis, sign] = used
                used += count - 1
        sums.mul_(_AT_RANDOM)
        places = product(range(cells[0]), range(cells[1]), (0, 1))
        for channel, (column, row, other) in enumerate(places):
            sums[channel, :used], sum_bias[channel] = 0.0, 1.0
            sums[channel, 2] = _BY_TIME
            sums[channel, other] = -2.0
            for axis, place in enumerate((column, row)):
                if place < cells[axis] - 1:
                    sums[channel, starts[axis, 1.0] + place] = -float(cells[axis])
                if place:
                    sums[channel, starts[axis, -1.0] + place - 1] = -float(cells[axis])

    def forward(self, points: Tensor, packet: Tensor, packets: int) -> Tensor:
        """Return f_e [packets, size]; an empty packet has the maximum zero, scaled.

        Args:
            points: All events of all packets, [E, 4].
            packet: Which packet each belongs to, int64 [E].
            packets: How many packets.
        """
        features = self.layers(points)
        empty = features.new_zeros(packets, self.size)
        index = packet[:, None].expand(-1, self.size)
        pooled = empty.scatter_reduce(0, index, features, 'amax', include_self=True)
        return torch.Tensor(self.scale(pooled))


class SparseBlock(nn.Module):
    """A convolution whose output exists only where its input does, then a step to half the size.

    The convolution is of the submanifold kind (Graham et al. 2018): a pixel without events stays
    empty, whatever its neighbours hold. It is computed on the dense grid with a mask, which gives
    the same numbers as a list of pixels would. The mean and variance of the normalisation are
    those of the pixels that exist.

    Args:
        inputs: Channels of the input.
        outputs: Channels of the output.
    """

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.convolution = nn.Conv2d(inputs, outputs, 3, padding=1, bias=False)
        self.norm = nn.BatchNorm1d(outputs)

    def forward(self, maps: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
        """Return maps and mask at half the size.

        Args:
            maps: [N, inputs, rows, columns], zero where the mask is.
            mask: bool [N, 1, rows, columns].
        """
        dense = self.convolution(maps)
        active = mask[:, 0]
        values = dense.permute(0, 2, 3, 1)[active]
        if len(values) > 1 or not self.training:
            values = self.norm(values)
        values = torch.relu(values)
        out = torch.zeros_like(dense).permute(0, 2, 3, 1).contiguous()
        out[active] = values.to(out.dtype)
        # Values are at least zero, so that empty pixels do not win the maximum.
        pooled = max_pool2d(out.permute(0, 3, 1, 2), 2, ceil_mode=True)
        return pooled, max_pool2d(mask.to(dense.dtype), 2, ceil_mode=True) > 0


class SparseBackbone(nn.Module):
    """Sparse blocks, then the mean over the pixels that are left.

    Args:
        inputs: Channels of the event frames.
        channels: Channels after each block.
    """

    def __init__(self, inputs: int, channels: tuple[int, ...]) -> None:
        super().__init__()
        widths = (inputs, *channels)
        self.scale = Scale(channels[-1])
        self.blocks = nn.ModuleList(SparseBlock(a, b) for a, b in pairwise(widths))

    def forward(self, event_frames: Tensor) -> Tensor:
        """Return features [N, channels] of event frames [N, inputs, rows, columns]."""
        maps, mask = event_frames, event_frames.abs().amax(1, keepdim=True) > 0
        for block in self.blocks:
            maps, mask = block(maps, mask)
        count = mask.sum((2, 3)).clamp(min=1)
        return torch.Tensor(self.scale(maps.sum((2, 3)) / count))
