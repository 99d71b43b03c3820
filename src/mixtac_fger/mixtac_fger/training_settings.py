# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""How long and how fast the stages of training run."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class TrainingSettings:
    """Settings of a training run; with its seed and data they fix the result.

    Attributes:
        seed: Of the initial weights and of the order and mirroring of the data.
        frame_epochs: Epochs of the frame network alone.
        recurrent_epochs: Epochs of the recurrent path on the frozen frame network.
        joint_epochs: Epochs of both together.
        frame_batch: Frames per update.
        chunk_windows: Windows per update of the recurrent path: gradients do not reach further.
        frame_rate: Largest learning rate of the frame stage.
        recurrent_rate: Largest learning rate of the recurrent stage.
        joint_rate: Largest learning rate of the joint stage.
        weight_decay: AdamW's.
        loss_knee_n: Errors above this count linearly, below it quadratically [N].
        gain_prior: Weight of the sensors' mean square log gain in the loss [N]; see `Trainer`.
        mirror: Show mirror images too.
    """

    seed: int = 0
    frame_epochs: int = 30
    recurrent_epochs: int = 60
    joint_epochs: int = 10
    frame_batch: int = 128
    chunk_windows: int = 100
    frame_rate: float = 2e-3
    recurrent_rate: float = 3e-3
    joint_rate: float = 5e-4
    weight_decay: float = 1e-3
    loss_knee_n: float = 0.05
    gain_prior: float = 0.01
    mirror: bool = True

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as JSON-ready values."""
        return asdict(self)
