# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Convolutions on the pixels that hold events, and on no others."""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn.functional import max_pool2d


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
        self.blocks = nn.ModuleList(SparseBlock(a, b) for a, b in pairwise(widths))

    def forward(self, event_frames: Tensor) -> Tensor:
        """Return features [N, channels] of event frames [N, inputs, rows, columns]."""
        maps, mask = event_frames, event_frames.abs().amax(1, keepdim=True) > 0
        for block in self.blocks:
            maps, mask = block(maps, mask)
        count = mask.sum((2, 3)).clamp(min=1)
        return torch.Tensor(maps.sum((2, 3)) / count)
