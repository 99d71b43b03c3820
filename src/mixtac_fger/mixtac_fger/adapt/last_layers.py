# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Fine-tuning of what turns features into forces, drawn back to where it started."""

from __future__ import annotations

import copy
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn

from mixtac_fger.train.gained_network import GainedNetwork
from mixtac_fger.train.loop import LoopSettings, TrainingLoop
from mixtac_fger.train.sequence_groups import MemoryGroups
from mixtac_fger.train.sequence_stage import SequenceStage
from mixtac_fger.training_settings import TrainingSettings

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mixtac_fger.batches import Sequences
    from mixtac_fger.network import FgerNetwork

SETTINGS = TrainingSettings(
    recurrent_epochs=8, recurrent_rate=1e-3, weight_decay=0.0, mirror=False, force_weight=2.0
)
"""Few updates at a low rate."""
PULL = 0.01
"""Weight of the sum of squared changes of the weights in the loss [N]."""


@dataclass(eq=False)
class LastLayers(SequenceStage):
    """Trains the layers that end in a force: MLP_df and MLP_corr."""

    start: list[Tensor] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Keep where the weights start."""
        self.start = [parameter.detach().clone() for parameter in self.parameters()]

    @property
    def name(self) -> str:
        """Of the stage."""
        return 'last layers'

    def begin(self) -> None:
        """Begin with the weights as they are."""

    def parameters(self) -> list[nn.Parameter]:
        """Return what is trained."""
        network = self.model.network
        return [*network.increment.parameters(), *network.correction.parameters()]

    def losses(self, random: torch.Generator) -> Iterator[Tensor]:
        """Yield the losses of one epoch, each with the pull towards the start."""
        for loss in super().losses(random):
            pairs = zip(self.parameters(), self.start, strict=True)
            change = torch.stack([(now - then).square().sum() for now, then in pairs]).sum()
            yield loss + PULL * change


def tuned(network: FgerNetwork, data: Sequences, seed: int = 0) -> FgerNetwork:
    """Return a copy of a network with its last layers fitted to presses.

    Args:
        network: Not changed.
        data: Presses side by side, all of one sensor.
        seed: Of the borders between updates.

    Raises:
        TrainingError: The loss is no number any more.
    """
    model = GainedNetwork(network.config, 1)
    model.network = copy.deepcopy(network)
    loop = TrainingLoop(model, LoopSettings(seed, SETTINGS.weight_decay))
    loop.run([LastLayers(model, MemoryGroups(data), SETTINGS)])
    return model.network.eval()
