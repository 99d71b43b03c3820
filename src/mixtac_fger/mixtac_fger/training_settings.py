# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""How long and how fast the stages of training run."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from typing import TYPE_CHECKING, Any

from mixtac_fger.errors import ConfigError

if TYPE_CHECKING:
    import torch


@dataclass(frozen=True, slots=True)
class TrainingSettings:
    """Settings of a training run; with its seed and data they fix the result.

    Attributes:
        seed: Of the initial weights and of the order and mirroring of the data.
        frame_epochs: Epochs of the frame network alone.
        recurrent_epochs: Epochs of the recurrent path on the frozen frame network.
        joint_epochs: Epochs of both together.
        deviation_epochs: Epochs of the uncertainty head on the finished network.
        frame_batch: Frames per update.
        chunk_windows: Windows per update of the recurrent path: gradients do not reach further.
        frame_rate: Largest learning rate of the frame stage.
        recurrent_rate: Largest learning rate of the recurrent stage.
        joint_rate: Largest learning rate of the joint stage.
        deviation_rate: Largest learning rate of the uncertainty head.
        weight_decay: AdamW's.
        loss_knee_n: Errors above this count linearly, below it quadratically [N].
        gain_prior: Weight of the sensors' mean square log gain in the loss [N]; see `Trainer`.
        mirror: Show mirror images too.
        force_weight: How much more an error counts per newton of force [1/N]; impacts are short.
        blow_every: After so many updates of the recurrent path comes one on blows only, cut out of
            the trials (`mixtac_fger.train.blows`); 0 for none.
        group_trials: Trials in memory at a time.
        patience: Epochs without a better validation error after which a stage ends; 0 for never.
    """

    seed: int = 0
    frame_epochs: int = 30
    recurrent_epochs: int = 60
    joint_epochs: int = 10
    deviation_epochs: int = 10
    frame_batch: int = 128
    chunk_windows: int = 100
    frame_rate: float = 2e-3
    recurrent_rate: float = 3e-3
    joint_rate: float = 5e-4
    deviation_rate: float = 3e-3
    weight_decay: float = 1e-3
    loss_knee_n: float = 0.05
    gain_prior: float = 0.01
    mirror: bool = True
    force_weight: float = 0.0
    blow_every: int = 0
    group_trials: int = 128
    patience: int = 0

    def flips(self, random: torch.Generator) -> tuple[bool, bool]:
        """Return whether to mirror columns and rows this time."""
        if not self.mirror:
            return False, False
        import torch

        columns, rows = torch.randint(0, 2, (2,), generator=random).tolist()
        return bool(columns), bool(rows)

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> TrainingSettings:
        """Return the settings of such values; absent ones keep their defaults.

        Raises:
            ConfigError: A field is unknown.
        """
        known = {field.name for field in fields(cls)}
        if odd := sorted(set(values) - known):
            raise ConfigError(f'training has no settings {odd}; it has {sorted(known)}')
        return cls(**values)

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as JSON-ready values."""
        return asdict(self)
