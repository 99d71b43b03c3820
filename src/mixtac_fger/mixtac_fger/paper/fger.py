# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""FGER-Net as the paper's Algorithm 1 writes it, and the network that has events only."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn

from mixtac_fger.paper.batch import PaperState
from mixtac_fger.paper.layers import FrameBackbone, PointEncoder, perceptron

if TYPE_CHECKING:
    from mixtac_fger.paper.batch import SegmentBatch
    from mixtac_fger.paper.config import PaperConfig


class EventRecurrence(nn.Module):
    """Lines 4 to 9 of Algorithm 1: events to increments of the force.

    Args:
        config: Shapes.
    """

    def __init__(self, config: PaperConfig) -> None:
        super().__init__()
        self.encoder = PointEncoder(config)
        self.lstm = nn.LSTMCell(self.encoder.size + 1, config.lstm_size)
        self.increment = perceptron(config.lstm_size, config.increment_size)

    def features(self, batch: SegmentBatch) -> Tensor:
        """Return f_e of all windows, [T, B, size]."""
        windows, sequences = batch.slots.shape
        encoded = self.encoder(batch.points, batch.packet, windows * sequences)
        return torch.Tensor(encoded.view(windows, sequences, -1))

    def step(self, features: Tensor, state: PaperState) -> PaperState:
        """Return the state after one window with features [B, size]."""
        inputs = torch.cat([features, state.force[:, None]], 1)
        hidden, cell = self.lstm(inputs, (state.hidden, state.cell))
        force = state.force + self.increment(hidden)[:, 0]
        return state._replace(hidden=hidden, cell=cell, force=force)


class EventsOnly(nn.Module):
    """The recurrence alone: no frame reaches it, neither as input nor through a gradient.

    Args:
        config: Shapes.
    """

    def __init__(self, config: PaperConfig) -> None:
        super().__init__()
        self.config = config
        self.recurrence = EventRecurrence(config)

    def initial_state(self, sequences: int) -> PaperState:
        """Return the state before any event: no force."""
        return _initial_state(self.config, self.recurrence.lstm.weight_ih, sequences)

    def forward(self, batch: SegmentBatch, state: PaperState) -> tuple[Tensor, PaperState]:
        """Return the force [N] at the end of each window, [T, B], and the state after the last."""
        forces = []
        for features in self.recurrence.features(batch):
            state = self.recurrence.step(features, state)
            forces.append(state.force)
        return torch.stack(forces), state


class FgerPaper(nn.Module):
    """FGER-Net.

    The estimate that is carried on is corrected once per cycle, by the frame whose arrival ends
    it. In inference `PaperConfig.correction` applies to what is given out: with `continuous` every
    window's estimate is corrected by the latest frame. That correction is not carried on: fed back
    500 times a second it is unstable, as training has seen it 25 times a second.

    Args:
        config: Shapes.
    """

    def __init__(self, config: PaperConfig) -> None:
        super().__init__()
        self.config = config
        self.frame = FrameBackbone(config)
        self.recurrence = EventRecurrence(config)
        self.correction = perceptron(1 + config.channels, config.correction_size)

    def initial_state(self, sequences: int) -> PaperState:
        """Return the state before any event: no force."""
        return _initial_state(self.config, self.recurrence.lstm.weight_ih, sequences)

    def forward(self, batch: SegmentBatch, state: PaperState) -> tuple[Tensor, PaperState]:
        """Return the force [N] at the end of each window, [T, B], and the state after the last."""
        continuous = not self.training and self.config.correction == 'continuous'
        frames = self.frame(batch.frames)
        state = recall(state, frames, batch)
        arrivals = (batch.slots >= 0).any(1).tolist()
        forces = []
        for features, slots, arrives in zip(
            self.recurrence.features(batch), batch.slots, arrivals, strict=True
        ):
            state = self.recurrence.step(features, state)
            fresh = slots >= 0
            if arrives:
                state = _see(state, frames, slots)
                force = torch.where(fresh, state.force + self._correct(state), state.force)
                state = state._replace(force=force)
            given = state.force
            if continuous:
                given = torch.where(state.seen & ~fresh, given + self._correct(state), given)
            forces.append(given)
        return torch.stack(forces), state

    def _correct(self, state: PaperState) -> Tensor:
        fusion = torch.cat([state.force[:, None], state.feature], 1)
        return torch.Tensor(self.correction(fusion)[:, 0])


def _initial_state(config: PaperConfig, like: Tensor, sequences: int) -> PaperState:
    zeros = like.new_zeros(sequences, config.lstm_size)
    feature = like.new_zeros(sequences, config.channels)
    seen = torch.zeros(sequences, dtype=torch.bool, device=like.device)
    return PaperState(zeros, zeros.clone(), like.new_zeros(sequences), feature, seen)


def _see(state: PaperState, frames: Tensor, slots: Tensor) -> PaperState:
    fresh = slots >= 0
    feature = torch.where(fresh[:, None], frames[slots.clamp(min=0)], state.feature)
    return state._replace(feature=feature, seen=state.seen | fresh)


def recall(state: PaperState, frames: Tensor, batch: SegmentBatch) -> PaperState:
    """Return the state with the frame that was the latest before the stretch, where there is."""
    if not len(frames):
        return state
    return _see(state, frames, batch.before)
