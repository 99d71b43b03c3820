# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Training FGER-Net from samples: all stages, one after the other."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

from mixtac_learning.train.batches import MemoryGroups
from mixtac_learning.train.loop import LoopSettings, TrainingLoop
from mixtac_learning.train.parallel import Processes
from mixtac_learning.train.stages import (
    DeviationStage,
    FrameStage,
    NetworkWithGains,
    SequenceStage,
    calibrate_deviation,
    collect,
)

if TYPE_CHECKING:
    from pathlib import Path

    from torch import Tensor

    from mixtac_fger.config import FgerConfig
    from mixtac_learning.network import FgerNetwork
    from mixtac_learning.train.batches import SequenceGroups, Sequences
    from mixtac_learning.train.config import TrainingSettings
    from mixtac_learning.train.loop import Report, Stage


class Trainer:
    """Trains one network.

    Args:
        config: Network configuration.
        settings: Stages and rates.
        report: Called after each epoch; see `mixtac_learning.train.loop.Report`.
        processes: Processes that share the training.
        device: Device to compute on.
        checkpoint: File to resume from; None for none.
        fingerprint: Identifies the run; kept in the checkpoint.

    Attributes:
        curves: One row per epoch, after `run`.
    """

    def __init__(
        self,
        config: FgerConfig,
        settings: TrainingSettings,
        report: Report | None = None,
        *,
        processes: Processes | None = None,
        device: str = 'cpu',
        checkpoint: Path | None = None,
        fingerprint: str = '',
    ) -> None:
        self._config, self._settings = config, settings
        self._report = report or (lambda *_: None)
        self._processes = processes or Processes()
        self._device = torch.device(device)
        self._checkpoint, self._fingerprint = checkpoint, fingerprint
        self.curves: list[dict[str, object]] = []

    def run(
        self, data: Sequences | SequenceGroups, checked: Sequences | SequenceGroups | None = None
    ) -> FgerNetwork:
        """Run all stages and return the network, on the CPU in evaluation mode.

        Args:
            data: Trials to train on, in memory or in groups.
            checked: Trials to validate on; None for none.

        Raises:
            TrainingError: As `TrainingLoop.run`.
        """
        groups = _grouped(data)
        held = None if checked is None else _grouped(checked)
        settings, processes = self._settings, self._processes
        torch.manual_seed(settings.seed)
        model = NetworkWithGains(self._config, groups.devices)
        model.fit_scales(groups.load(0))
        processes.average_buffers(model)
        model.to(self._device)
        loop = TrainingLoop(
            model,
            LoopSettings(settings.seed, settings.weight_decay, patience=settings.patience),
            self._checkpoint,
            self._fingerprint,
            self._report,
            processes,
        )
        stages: list[Stage] = [
            FrameStage(model, groups, settings, processes, held),
            SequenceStage(model, groups, settings, checked=held),
            SequenceStage(model, groups, settings, joint=True, checked=held),
        ]
        if self._config.deviation_size:
            stages.append(DeviationStage(model, groups, settings))
        loop.run(stages)
        network = model.network.eval()
        if self._config.deviation_size:
            # Errors of trials that were trained on are too small to calibrate by.
            calibrate_deviation(network, collect(network, held or groups))
            processes.average_buffers(network)
        self.curves = loop.progress.curves
        return network.cpu()


def _grouped(data: Sequences | SequenceGroups) -> SequenceGroups:
    from mixtac_learning.train.batches import Sequences as InMemory

    return MemoryGroups(data) if isinstance(data, InMemory) else data


def estimate(network: FgerNetwork, sequences: Sequences) -> tuple[Tensor, Tensor]:
    """Run all sequences from their start.

    Returns:
        Force at the end of each window [T, B] and frames-only force of each frame [N], in N.
    """
    model = NetworkWithGains(network.config, 1)
    model.network = network
    return model.estimate(sequences)


def encode(network: FgerNetwork, sequences: Sequences) -> Tensor:
    """Return f_frame of all frames, [N, frame_size]."""
    model = NetworkWithGains(network.config, 1)
    model.network = network
    return model.encode(sequences)
