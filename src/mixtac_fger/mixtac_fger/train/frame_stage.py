# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Stage 1: the frame network with its own force output."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn
from torch.nn.functional import smooth_l1_loss

from mixtac_fger.batches import mirror_frames

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mixtac_fger.train.gained_network import GainedNetwork
    from mixtac_fger.train.parallel import Processes
    from mixtac_fger.train.sequence_groups import SequenceGroups
    from mixtac_fger.training_settings import TrainingSettings


@dataclass(eq=False)
class FrameStage:
    """Trains the frame network and the gains of the sensors on single frames.

    Attributes:
        model: Network and gains.
        groups: Trials to train on.
        settings: Epochs, batch, rate.
        processes: Who takes part.
        checked: Trials to validate on; None for none.
        name: Of the stage.
    """

    model: GainedNetwork
    groups: SequenceGroups
    settings: TrainingSettings
    processes: Processes
    checked: SequenceGroups | None = None
    name: str = 'frames'

    @property
    def epochs(self) -> int:
        """Epochs of the stage."""
        return self.settings.frame_epochs

    @property
    def rate(self) -> float:
        """Largest learning rate."""
        return self.settings.frame_rate

    def parameters(self) -> list[nn.Parameter]:
        """Return the weights of the frame network, and the gains."""
        return [*self.model.network.frame.parameters(), self.model.log_gains]

    def updates(self) -> int:
        """Return the number of updates per epoch, the same in all processes."""
        return sum(self._batches(index) for index in range(len(self.groups)))

    def losses(self, random: torch.Generator) -> Iterator[Tensor]:
        """Yield the losses of one epoch: groups in random order, frames shuffled within each."""
        for group in torch.randperm(len(self.groups), generator=random).tolist():
            sequences = self.groups.load(group).to(self.model.device)
            labels = sequences.frame_force
            device = sequences.device[sequences.frame_trial]
            order = torch.randperm(len(labels), generator=random)
            rows = torch.split(order, self.settings.frame_batch)[: self._batches(group)]
            for chosen in rows:
                flips = self.settings.flips(random)
                frames = sequences.frame_inputs[chosen].float()
                inputs = mirror_frames(frames, self.model.network.config, *flips)
                force = self.model.network.frame.force(self.model.network.frame(inputs))
                gain = self.model.log_gains[device[chosen]].exp()
                loss = smooth_l1_loss(gain * force, labels[chosen], beta=self.settings.loss_knee_n)
                yield loss + self.settings.gain_prior * self.model.log_gains.square().mean()

    def validate(self) -> float | None:
        """Return the mean absolute error of frames alone on the trials to validate on [N]."""
        if self.checked is None:
            return None
        total, count = 0.0, 0
        for index in range(len(self.checked)):
            sequences = self.checked.load(index).to(self.model.device)
            features = self.model.encode(sequences)
            error = self.model.network.frame.force(features) - sequences.frame_force
            total, count = total + float(error.abs().sum()), count + len(error)
        return total / count

    def _batches(self, group: int) -> int:
        own = -(-len(self.groups.load(group).frame_force) // self.settings.frame_batch)
        return self.processes.smallest(own)
