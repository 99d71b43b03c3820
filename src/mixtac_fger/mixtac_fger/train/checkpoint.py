# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Where a training run stands, in one safetensors file, so that a killed run can go on.

The file holds the weights, the best weights so far, the optimiser's moments and the state of the
random numbers as tensors, and all else as JSON in its header. It is replaced only once the new one
is complete: a kill at any moment leaves a whole file.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import torch

from mixtac_fger.errors import TrainingError
from mixtac_fger.tensor_file import read_tensors, write_tensors

if TYPE_CHECKING:
    from pathlib import Path

    from torch import Tensor, nn

SCHEMA = '1'


@dataclass(slots=True)
class Progress:
    """How far a run is.

    Attributes:
        stage: Index of the present stage.
        epoch: Epochs of it that are done.
        best: Smallest validation error of the stage; None before the first.
        since_best: Epochs since then.
        curves: One row per epoch: stage, epoch, loss, validation error, seconds.
    """

    stage: int = 0
    epoch: int = 0
    best: float | None = None
    since_best: int = 0
    curves: list[dict[str, Any]] = field(default_factory=list)


def save_checkpoint(
    path: Path,
    module: nn.Module,
    best: dict[str, Tensor],
    optimiser: torch.optim.Optimizer,
    random: torch.Generator,
    progress: Progress,
    fingerprint: str,
) -> None:
    """Write a checkpoint.

    Args:
        path: File.
        module: Its weights.
        best: Best weights of the present stage, by name; empty for none.
        optimiser: Its moments.
        random: Its state.
        progress: How far the run is.
        fingerprint: What the run is of; see `load_checkpoint`.
    """
    tensors = {f'model.{name}': value for name, value in module.state_dict().items()}
    tensors |= {f'best.{name}': value for name, value in best.items()}
    tensors |= {'random': random.get_state(), 'global_random': torch.get_rng_state()}
    for index, parameter in enumerate(_parameters(optimiser)):
        for name, value in optimiser.state.get(parameter, {}).items():
            tensors[f'optimiser.{index}.{name}'] = torch.as_tensor(value)
    state = {name: getattr(progress, name) for name in Progress.__slots__}
    header = {'schema': SCHEMA, 'fingerprint': fingerprint, 'progress': json.dumps(state)}
    write_tensors(path, tensors, header)


@dataclass(frozen=True, slots=True, eq=False)
class Checkpoint:
    """What `load_checkpoint` found.

    Attributes:
        progress: How far the run is.
        tensors: By name, as written.
    """

    progress: Progress
    tensors: dict[str, Tensor]

    def restore_module(self, module: nn.Module) -> None:
        """Give a module its weights back."""
        module.load_state_dict(self._part('model.'))

    def best(self) -> dict[str, Tensor]:
        """Return the best weights of the present stage."""
        return self._part('best.')

    def restore_optimiser(self, optimiser: torch.optim.Optimizer) -> None:
        """Give an optimiser its moments back."""
        for index, parameter in enumerate(_parameters(optimiser)):
            found = self._part(f'optimiser.{index}.')
            if found:
                optimiser.state[parameter] = {
                    name: value if name == 'step' else value.to(parameter.device)
                    for name, value in found.items()
                }

    def restore_random(self, random: torch.Generator) -> None:
        """Give the random numbers their state back."""
        random.set_state(self.tensors['random'])
        torch.set_rng_state(self.tensors['global_random'])

    def _part(self, prefix: str) -> dict[str, Tensor]:
        cut = len(prefix)
        return {k[cut:]: v for k, v in self.tensors.items() if k.startswith(prefix)}


def load_checkpoint(path: Path, fingerprint: str) -> Checkpoint | None:
    """Read a checkpoint.

    Args:
        path: File.
        fingerprint: Of the run that wants to go on.

    Returns:
        The checkpoint, None where there is none.

    Raises:
        TrainingError: It belongs to a run with other settings or data, or cannot be read.
    """
    if not path.exists():
        return None
    header, tensors = read_tensors(path, TrainingError, 'remove it to start over')
    if header.get('schema') != SCHEMA or header.get('fingerprint') != fingerprint:
        raise TrainingError(
            f'{path} belongs to a run with other settings or other data: give another folder with'
            ' --folder, or remove it to start over'
        )
    return Checkpoint(Progress(**json.loads(header['progress'])), tensors)


def _parameters(optimiser: torch.optim.Optimizer) -> list[nn.Parameter]:
    return [parameter for group in optimiser.param_groups for parameter in group['params']]
