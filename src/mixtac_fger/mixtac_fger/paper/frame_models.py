# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Baselines that speak once per frame: frames only, and feature level deep fusion."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn

from mixtac_fger.paper.batch import PaperState
from mixtac_fger.paper.layers import FrameBackbone, perceptron
from mixtac_fger.paper.sparse_convolution import SparseBackbone

if TYPE_CHECKING:
    from mixtac_fger.paper.batch import SegmentBatch
    from mixtac_fger.paper.config import PaperConfig


class FrameModel(nn.Module):
    """A network with one force per frame, held until the next.

    Args:
        config: Shapes.
    """

    def __init__(self, config: PaperConfig) -> None:
        super().__init__()
        self.config = config

    def initial_state(self, sequences: int) -> PaperState:
        """Return the state before the first frame: no force."""
        device = next(self.parameters()).device
        none = torch.zeros(sequences, 0, device=device)
        seen = torch.zeros(sequences, dtype=torch.bool, device=device)
        return PaperState(none, none, torch.zeros(sequences, device=device), none, seen)

    def frame_force(self, batch: SegmentBatch) -> Tensor:
        """Return the force [N] of each frame, [N]."""
        raise NotImplementedError

    def forward(self, batch: SegmentBatch, state: PaperState) -> tuple[Tensor, PaperState]:
        """Return the force [N] at the end of each window, [T, B], and the state after the last."""
        own = self.frame_force(batch) if len(batch.frames) else batch.force.new_zeros(1)
        known = torch.where(batch.before >= 0, own[batch.before.clamp(min=0)], state.force)
        forces = []
        for slots in batch.slots:
            known = torch.where(slots >= 0, own[slots.clamp(min=0)], known)
            forces.append(known)
        return torch.stack(forces), state._replace(force=known)


class FramesOnly(FrameModel):
    """The frame feature fed directly into a regression head.

    Args:
        config: Shapes.
    """

    def __init__(self, config: PaperConfig) -> None:
        super().__init__(config)
        self.frame = FrameBackbone(config)
        self.head = perceptron(config.channels, config.correction_size)

    def frame_force(self, batch: SegmentBatch) -> Tensor:
        """Return the force [N] of each frame, [N]."""
        return torch.Tensor(self.head(self.frame(batch.frames))[:, 0])


class FeatureFusion(FrameModel):
    """Two convolutional networks side by side, their features concatenated, a perceptron on top.

    Args:
        config: Shapes.
    """

    def __init__(self, config: PaperConfig) -> None:
        super().__init__(config)
        self.frame = FrameBackbone(config)
        self.events = SparseBackbone(2, config.sparse_channels)
        inputs = config.channels + config.sparse_channels[-1]
        self.head = perceptron(inputs, config.correction_size)

    def frame_force(self, batch: SegmentBatch) -> Tensor:
        """Return the force [N] of each frame, [N]."""
        features = [self.frame(batch.frames), self.events(batch.event_frames)]
        return torch.Tensor(self.head(torch.cat(features, 1))[:, 0])
