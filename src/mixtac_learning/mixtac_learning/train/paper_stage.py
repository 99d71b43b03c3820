# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Training of the paper's networks."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.functional import smooth_l1_loss

from mixtac_learning.paper.config import PaperConfig
from mixtac_learning.paper.networks import (
    CYCLE_US,
    FrameBackbone,
    FrameModel,
    PaperNetwork,
    SegmentBatch,
    build,
)
from mixtac_learning.paper.samples import PaperSample
from mixtac_learning.paper.segments import assemble, cut_segments, run_samples
from mixtac_learning.train.loop import Stage, TrainingError, TrainingLoop
from mixtac_learning.train.parallel import Processes


@dataclass(frozen=True, slots=True)
class PaperTraining:
    """The paper's protocol: 50 epochs, batches of 128, AdamW at 1e-4 (section III-C).

    The paper does not state what a batch holds, how long its sequences are, or how the estimate
    before a stretch is known. Here a batch holds 128 cycles (frame intervals), as stretches of
    `cycles` for the recurrent networks, that start at the true force plus an error, which the
    correction learns to remove. Networks without frames start at the true force.

    Attributes:
        seed: Random seed for weights and order.
        epochs: Passes over all trials.
        batch: Cycles per update.
        rate: Learning rate of AdamW, constant.
        weight_decay: AdamW's default.
        cycles: Length of a stretch of the recurrent networks [cycles].
        start_error_n: Standard deviation of the error of the estimate before a stretch [N].
        loss_knee_n: Errors above count linearly, below quadratically [N].
        patience: Epochs without a better validation error before it ends; 0 for never.
        checked: Part of the training trials that is held out for validation, so that the test
            trials play no role.
    """

    seed: int = 0
    epochs: int = 50
    batch: int = 128
    rate: float = 1e-4
    weight_decay: float = 1e-2
    cycles: int = 4
    start_error_n: float = 0.1
    loss_knee_n: float = 0.05
    patience: int = 0
    checked: float = 0.1


@dataclass(eq=False)
class PaperStage(Stage):
    """The only stage of the training of one network.

    Attributes:
        network: The network.
        samples: Trials to train on; of these, `own` are this process's.
        settings: The protocol.
        processes: Processes that share the training.
        own: Indices of this process's trials.
        checked: Trials to validate on.
    """

    network: PaperNetwork
    samples: Sequence[PaperSample]
    settings: PaperTraining
    processes: Processes
    own: Sequence[int]
    checked: Sequence[PaperSample] = ()

    def __post_init__(self) -> None:
        """Take epochs, rate, and the size of stretches and updates from the settings."""
        self.name = 'paper'
        self.epochs, self.rate = self.settings.epochs, self.settings.rate
        # A stretch of one cycle is enough for the networks without a memory.
        cycles = 1 if isinstance(self.network, FrameModel) else self.settings.cycles
        self._windows = cycles * (CYCLE_US // self.network.config.window_us)
        self._segments = max(self.settings.batch // cycles, 1)

    def parameters(self) -> list[nn.Parameter]:
        """Return all weights."""
        return list(self.network.parameters())

    def updates(self) -> int:
        """Return the number of updates per epoch, the same in all processes."""
        usual = len(cut_segments(self.samples, self._windows, 0, self.own)) // self._segments
        return max(self.processes.smallest(usual), 1)

    def losses(self, random: torch.Generator) -> Iterator[Tensor]:
        """Yield the losses of one epoch, stretches in random order."""
        count = self.updates()
        shift = int(torch.randint(self._windows, (1,), generator=random))
        segments = cut_segments(self.samples, self._windows, shift, self.own)
        order = torch.randperm(len(segments), generator=random).tolist()
        size = self._segments
        # A shift can cost a stretch; the first ones of the order stand in for it.
        order += order[: max(count * size - len(order), 0)]
        device = next(self.network.parameters()).device
        for update in range(count):
            chosen = [segments[i] for i in order[update * size : (update + 1) * size]]
            batch = assemble(self.samples, chosen, self.network.config.model).to(device)
            yield self._loss(batch, random)

    def validate(self) -> float | None:
        """Return the mean absolute error on the trials to validate on [N]."""
        if not self.checked:
            return None
        total, count = 0.0, 0
        for sample, force in zip(
            self.checked, run_samples(self.network, self.checked), strict=True
        ):
            total, count = total + float(abs(force - sample.force).sum()), count + len(force)
        return total / count

    def _loss(self, batch: SegmentBatch, random: torch.Generator) -> Tensor:
        knee = self.settings.loss_knee_n
        if isinstance(self.network, FrameModel):
            known = batch.frame_force
            return smooth_l1_loss(self.network.frame_force(batch), known, beta=knee)
        state = self.network.initial_state(len(batch.start))
        error = torch.randn(len(batch.start), generator=random).to(batch.start)
        spread = 0.0 if self.network.config.model == 'events' else self.settings.start_error_n
        force, _ = self.network(batch, state._replace(force=batch.start + spread * error))
        return smooth_l1_loss(force, batch.force, beta=knee)


def train_paper(
    config: PaperConfig,
    settings: PaperTraining,
    samples: Sequence[PaperSample],
    checked: Sequence[PaperSample],
    *,
    device: str,
    processes: Processes,
    make_loop: Callable[..., TrainingLoop],
) -> tuple[PaperNetwork, list[dict[str, Any]]]:
    """Train one network and return it, on the CPU in evaluation mode, and the curves.

    The mean and spread of the frame network's input are set to those of the training trials.

    Args:
        config: Shapes.
        settings: The protocol.
        samples: Trials to train on.
        checked: Trials to validate on.
        device: Device to compute on.
        processes: Processes that share the training.
        make_loop: Makes the loop, with the checkpoint and the report of the run.

    Raises:
        TrainingError: As `TrainingLoop.run`, or there are fewer trials than processes.
    """
    torch.manual_seed(settings.seed)
    network = build(config)
    backbone = getattr(network, 'frame', None)
    if isinstance(backbone, FrameBackbone):
        frames = torch.cat([torch.from_numpy(each.frames[::10].astype('f4')) for each in samples])
        backbone.mean.fill_(frames.mean())
        backbone.deviation.fill_(frames.std().clamp(min=1e-3))
    network.to(device)
    own = processes.share(range(len(samples)))
    if not own:
        raise TrainingError(f'{len(samples)} trials for {processes.world} processes')
    loop = make_loop(
        network,
        seed=settings.seed,
        weight_decay=settings.weight_decay,
        schedule='constant',
        patience=settings.patience,
        processes=processes,
    )
    loop.run([PaperStage(network, samples, settings, processes, own, checked)])
    return network.cpu().eval(), loop.progress.curves
