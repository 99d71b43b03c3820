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
from mixtac_fger.train.blows import blows
from mixtac_fger.train.frame_follower import follow_frames

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
    _cut_out: dict[int, Sequences | None] = field(default_factory=dict)

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

    def begin(self) -> None:
        """Let the recurrent path begin as what follows the frames."""
        if not self.joint:
            follow_frames(self.model.network)

    def parameters(self) -> list[nn.Parameter]:
        """Return what is trained."""
        network = self.model.network
        kept = [p for p in network.children() if p is not network.deviation]
        if not self.joint:
            kept.remove(network.frame)
        return [parameter for part in kept for parameter in part.parameters()]

    def updates(self) -> int:
        """Return the usual number of updates per epoch."""
        length = len(self.groups.load(0).force)
        stretches = -(-length // self.settings.chunk_windows)
        every = self.settings.blow_every
        return len(self.groups) * (stretches + (-(-stretches // every) if every else 0))

    def losses(self, random: torch.Generator) -> Iterator[Tensor]:
        """Yield the losses of one epoch, group by group in random order."""
        for group in torch.randperm(len(self.groups), generator=random).tolist():
            sequences = self.groups.load(group).to(self.model.device)
            flip = self.settings.flips(random)
            frozen = None if self.joint else self._features(group, sequences, flip)
            state = self.model.network.initial_state(sequences.force.shape[1])
            cut_out = self._blows(group, sequences)
            for number, (start, stop) in enumerate(self._chunks(len(sequences.force), random)):
                if cut_out is not None and number % self.settings.blow_every == 0:
                    yield self._blow_loss(cut_out, frozen, flip)
                slots = FrameSlots(*(part[start:stop] for part in sequences.slots))
                features, local = (
                    self._encode_now(sequences, flip, slots) if frozen is None else (frozen, slots)
                )
                events = mirror_events(sequences.event_features[start:stop].float(), *flip)
                force, state = self.model.network(events, features, local, state)
                state = state.detached()
                yield self._loss(force, sequences, slice(start, stop))

    def _blows(self, group: int, sequences: Sequences) -> Sequences | None:
        """Return the blows of a group; kept where there is one group only."""
        if not self.settings.blow_every:
            return None
        if len(self.groups) > 1:
            return blows(sequences)
        if group not in self._cut_out:
            self._cut_out[group] = blows(sequences)
        return self._cut_out[group]

    def _blow_loss(self, cut_out: Sequences, frozen: Tensor | None, flip: Flip) -> Tensor:
        """Return the loss of the blows, from no contact on."""
        features, slots = (
            self._encode_now(cut_out, flip, cut_out.slots)
            if frozen is None
            else (frozen, cut_out.slots)
        )
        state = self.model.network.initial_state(cut_out.force.shape[1])
        events = mirror_events(cut_out.event_features.float(), *flip)
        force, _ = self.model.network(events, features, slots, state)
        return self._loss(force, cut_out, slice(None))

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
