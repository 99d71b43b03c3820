# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Stage 4: how uncertain the force is, learned from the errors of the finished network.

The likelihood is Laplace's, as errors have heavy tails. The temperature is fitted afterwards, on
trials that were held out: one deviation to both sides covers as much as a Gaussian's does. Windows
of one trial err together, so that n trials tell the temperature as n draws do, and a further trial
spreads like Student's t with n degrees of freedom. Gains of the sensors are not used: the error
that an unknown stiffness makes belongs to the uncertainty.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn

from mixtac_fger.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from mixtac_fger.deviation_head import DeviationHead
    from mixtac_fger.network import FgerNetwork
    from mixtac_fger.train.gained_network import GainedNetwork
    from mixtac_fger.train.sequence_groups import SequenceGroups
    from mixtac_fger.training_settings import TrainingSettings

COVERED = 0.6827
"""Part of the held-out windows within one deviation: that of a Gaussian."""
_WINDOWS = 100_000
"""Windows that are learned from, at most, drawn at random."""
_BATCH = 1024


@dataclass(frozen=True, slots=True, eq=False)
class Errors:
    """Windows of finished estimates.

    Attributes:
        hidden: Recurrent state, [N, lstm_size].
        force: Estimate [N], [N].
        error: Estimate minus known force [N], [N].
        trials: Number of trials that they are from.
    """

    hidden: Tensor
    force: Tensor
    error: Tensor
    trials: int


def joined(parts: Sequence[Errors]) -> Errors:
    """Return the windows of all parts, which are from different trials."""
    return Errors(
        torch.cat([part.hidden for part in parts]),
        torch.cat([part.force for part in parts]),
        torch.cat([part.error for part in parts]),
        sum(part.trials for part in parts),
    )


@dataclass(eq=False)
class DeviationStage:
    """Trains the uncertainty head; nothing else changes.

    Attributes:
        model: Network and gains.
        groups: Trials to train on.
        settings: Epochs and rate.
        checked: Trials to validate on; None for none.
        name: Of the stage.
    """

    model: GainedNetwork
    groups: SequenceGroups
    settings: TrainingSettings
    checked: SequenceGroups | None = None
    name: str = 'deviation'
    _errors: list[Errors] = field(default_factory=list)

    @property
    def epochs(self) -> int:
        """Epochs of the stage."""
        return self.settings.deviation_epochs

    @property
    def rate(self) -> float:
        """Largest learning rate."""
        return self.settings.deviation_rate

    def parameters(self) -> list[nn.Parameter]:
        """Return the weights of the head."""
        return list(head_of(self.model.network).parameters())

    def updates(self) -> int:
        """Return the number of updates per epoch."""
        return -(-len(self._collected().error) // _BATCH)

    def losses(self, random: torch.Generator) -> Iterator[Tensor]:
        """Yield the losses of one epoch in random order."""
        errors = self._collected()
        order = torch.randperm(len(errors.error), generator=random)
        for chosen in torch.split(order, _BATCH):
            yield self._loss(
                replace(
                    errors,
                    hidden=errors.hidden[chosen],
                    force=errors.force[chosen],
                    error=errors.error[chosen],
                )
            )

    def validate(self) -> float | None:
        """Return nothing: the temperature is fitted to the held-out trials afterwards."""
        return None

    def _loss(self, errors: Errors) -> Tensor:
        log_deviation = head_of(self.model.network).log_deviation(errors.hidden, errors.force)
        ratio = errors.error.abs() * torch.exp(-log_deviation)
        return torch.Tensor((log_deviation + ratio).mean())

    def _collected(self) -> Errors:
        if not self._errors:
            self._errors.append(collect(self.model.network, self.groups))
        return self._errors[0]


def head_of(network: FgerNetwork) -> DeviationHead:
    """Return the uncertainty head.

    Raises:
        ModelError: There is none.
    """
    if network.deviation is None:
        raise ModelError('this network has no uncertainty head: set deviation_size above 0')
    return network.deviation


@torch.no_grad()
def collect(network: FgerNetwork, groups: SequenceGroups, most: int = _WINDOWS) -> Errors:
    """Return states, estimates and errors of at most `most` windows, drawn at random."""
    random = torch.Generator().manual_seed(0)
    share = max(most // len(groups), 1)
    device = next(network.parameters()).device
    parts = []
    for index in range(len(groups)):
        sequences = groups.load(index).to(device)
        frames = torch.split(sequences.frame_inputs, _BATCH)
        features = torch.cat([network.frame(part.float()) for part in frames])
        trials = sequences.force.shape[1]
        state = network.initial_state(trials)
        events = sequences.event_features.float()
        course = network.course(events, features, sequences.slots, state)
        rows = torch.nonzero(sequences.valid.flatten())[:, 0]
        rows = rows[torch.randperm(len(rows), generator=random)[:share].to(device)]
        force = course.force.flatten()[rows]
        error = force - sequences.force.flatten()[rows]
        parts.append(Errors(course.hidden.flatten(0, 1)[rows], force, error, trials))
    return joined(parts)


@torch.no_grad()
def calibrate_deviation(network: FgerNetwork, errors: Errors) -> float:
    """Set the head's scale so that one deviation covers `COVERED` of a further trial; return it."""
    from scipy.stats import t as student

    head = head_of(network)
    ratio = errors.error.abs() * torch.exp(-head.log_deviation(errors.hidden, errors.force))
    few_trials = float(student.ppf(0.5 * (1.0 + COVERED), errors.trials))
    scale = few_trials * float(torch.quantile(ratio, COVERED))
    head.scale.fill_(max(scale, 1e-3))
    return float(head.scale)
