# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Stages 2 and 3: the recurrent path on a frozen frame network, then both together."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn
from torch.nn.functional import smooth_l1_loss

from mixtac_fger.batches import mirror_events, mirror_frames
from mixtac_fger.network import FrameSlots

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mixtac_fger.batches import Sequences
    from mixtac_fger.train.gained_network import GainedNetwork
    from mixtac_fger.train.sequence_groups import SequenceGroups
    from mixtac_fger.training_settings import TrainingSettings

    Flip = tuple[bool, bool]


@dataclass(eq=False)
class SequenceStage:
    """Truncated back-propagation through all sequences of a group side by side.

    Attributes:
        model: Network and gains; the gains stay as they are.
        groups: Trials to train on.
        settings: Epochs, stretches, rates.
        joint: Whether the frame network learns as well.
        checked: Trials to validate on; None for none.
    """

    model: GainedNetwork
    groups: SequenceGroups
    settings: TrainingSettings
    joint: bool = False
    checked: SequenceGroups | None = None
    _encoded: dict[tuple[int, Flip], Tensor] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Of the stage."""
        return 'joint' if self.joint else 'recurrent'

    @property
    def epochs(self) -> int:
        """Epochs of the stage."""
        return self.settings.joint_epochs if self.joint else self.settings.recurrent_epochs

    @property
    def rate(self) -> float:
        """Largest learning rate."""
        return self.settings.joint_rate if self.joint else self.settings.recurrent_rate

    def parameters(self) -> list[nn.Parameter]:
        """Return what is trained."""
        parts = self.model.network.children()
        kept = (p for p in parts if self.joint or p is not self.model.network.frame)
        return [parameter for part in kept for parameter in part.parameters()]

    def updates(self) -> int:
        """Return the usual number of updates per epoch."""
        length = len(self.groups.load(0).force)
        return len(self.groups) * -(-length // self.settings.chunk_windows)

    def losses(self, random: torch.Generator) -> Iterator[Tensor]:
        """Yield the losses of one epoch, group by group in random order."""
        for group in torch.randperm(len(self.groups), generator=random).tolist():
            sequences = self.groups.load(group).to(self.model.device)
            flip = self.settings.flips(random)
            frozen = None if self.joint else self._features(group, sequences, flip)
            state = self.model.network.initial_state(sequences.force.shape[1])
            for start, stop in self._chunks(len(sequences.force), random):
                slots = FrameSlots(*(part[start:stop] for part in sequences.slots))
                features, local = (
                    self._encode_now(sequences, flip, slots) if frozen is None else (frozen, slots)
                )
                events = mirror_events(sequences.event_features[start:stop].float(), *flip)
                force, state = self.model.network(events, features, local, state)
                state = state.detached()
                yield self._loss(force, sequences, slice(start, stop))

    def validate(self) -> float | None:
        """Return the mean absolute error on the trials to validate on [N]."""
        if self.checked is None:
            return None
        total, count = 0.0, 0
        for index in range(len(self.checked)):
            sequences = self.checked.load(index).to(self.model.device)
            force, _ = self.model.estimate(sequences)
            error = (force - sequences.force)[sequences.valid]
            total, count = total + float(error.abs().sum()), count + len(error)
        return total / count

    def _features(self, group: int, sequences: Sequences, flip: Flip) -> Tensor:
        """Return the features of all frames; kept where there is one group only."""
        if len(self.groups) > 1:
            return self.model.encode(sequences, *flip)
        if (group, flip) not in self._encoded:
            self._encoded[group, flip] = self.model.encode(sequences, *flip)
        return self._encoded[group, flip]

    def _encode_now(
        self, sequences: Sequences, flip: Flip, slots: FrameSlots
    ) -> tuple[Tensor, FrameSlots]:
        """Return the features of the frames that a stretch needs, with gradients."""
        used, index = torch.unique(slots.frame.clamp(min=0), return_inverse=True)
        frames = sequences.frame_inputs[used].float()
        inputs = mirror_frames(frames, self.model.network.config, *flip)
        local = torch.where(slots.frame >= 0, index, -1)
        return self.model.network.frame(inputs), FrameSlots(local, slots.lag)

    def _chunks(self, length: int, random: torch.Generator) -> Iterator[tuple[int, int]]:
        """Yield the stretches of one epoch; the first is cut at random so that borders move."""
        size = self.settings.chunk_windows
        first = int(torch.randint(size // 2, size + 1, (1,), generator=random))
        borders = [0, *range(min(first, length), length, size), length]
        yield from ((a, b) for a, b in pairwise(borders) if b > a)

    def _loss(self, force: Tensor, sequences: Sequences, windows: slice) -> Tensor:
        """Return the mean loss; forces count more the larger they are, as impacts are short."""
        valid = sequences.valid[windows]
        known = sequences.force[windows]
        knee, weight = self.settings.loss_knee_n, self.settings.force_weight
        scaled = self.model.gains[sequences.device] * force
        errors = smooth_l1_loss(scaled, known, beta=knee, reduction='none')
        weights = valid * (1.0 + weight * known.abs())
        return torch.Tensor((errors * weights).sum() / weights.sum().clamp(min=1.0))
