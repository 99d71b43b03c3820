# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Weight files: safetensors with a header that says what the numbers are."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from mixtac_fger.config import FgerConfig
from mixtac_fger.errors import ConfigError, ModelError
from mixtac_fger.network import ARCHITECTURE, VERSION, FgerNetwork

if TYPE_CHECKING:
    from pathlib import Path

    from torch import Tensor

_REMEDY = 'train one with "mixtac train" or use the model that comes with the package'
_WANTED = f'{ARCHITECTURE} version {VERSION}'


@dataclass(frozen=True, slots=True)
class ModelCard:
    """What a weight file says of itself.

    Attributes:
        training: Where the training data came from (seeds, trials, labels) and how it was trained.
        metrics: Figures on data that were not trained on.
    """

    training: dict[str, Any] = field(default_factory=dict)
    metrics: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class LoadedModel:
    """A network that is ready to use.

    Attributes:
        network: In evaluation mode, on the CPU.
        card: What the file says of itself.
    """

    network: FgerNetwork
    card: ModelCard

    @property
    def config(self) -> FgerConfig:
        """The configuration of the network."""
        return self.network.config


def save_model(path: Path, network: FgerNetwork, card: ModelCard) -> None:
    """Write a weight file; an existing file is replaced only once the new one is complete."""
    from safetensors.torch import save_file

    header = {
        'architecture': ARCHITECTURE,
        'version': str(VERSION),
        'config': json.dumps(network.config.to_dict()),
        'training': json.dumps(card.training),
        'metrics': json.dumps(card.metrics),
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(path.name + '.partial')
    tensors = {name: tensor.contiguous() for name, tensor in network.state_dict().items()}
    save_file(tensors, partial, metadata=header)
    partial.replace(path)


def load_model(path: Path) -> LoadedModel:
    """Read a weight file and check it.

    Args:
        path: A file written by `save_model`.

    Raises:
        ModelError: The file is missing or damaged, of another architecture or version, or its
            tensors do not have the shapes that its configuration asks for, or hold numbers that
            are not finite.
    """
    header, tensors = _read(path)
    found = f'{header.get("architecture", "no architecture")} version {header.get("version", "-")}'
    if found != _WANTED:
        raise ModelError(f'model {path} holds {found}, but {_WANTED} is needed: {_REMEDY}')
    try:
        config = FgerConfig.from_dict(json.loads(header['config']))
        card = ModelCard(json.loads(header['training']), json.loads(header['metrics']))
    except (KeyError, ValueError, TypeError, ConfigError) as error:
        message = f'model {path} has a header that cannot be used ({error}): {_REMEDY}'
        raise ModelError(message) from error
    network = FgerNetwork(config)
    _check_shapes(path, network, tensors)
    network.load_state_dict(tensors)
    return LoadedModel(network.eval(), card)


def _read(path: Path) -> tuple[dict[str, str], dict[str, Tensor]]:
    from safetensors import SafetensorError, safe_open

    if not path.is_file():
        raise ModelError(f'model {path} does not exist, but {_WANTED} is needed: {_REMEDY}')
    try:
        with safe_open(path, framework='pt') as file:
            return file.metadata() or {}, {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError) as error:
        message = (
            f'model {path} is not a safetensors file ({error}); {_WANTED} is needed: {_REMEDY}'
        )
        raise ModelError(message) from error


def _check_shapes(path: Path, network: FgerNetwork, tensors: dict[str, Tensor]) -> None:
    wanted = {name: tuple(tensor.shape) for name, tensor in network.state_dict().items()}
    found = {name: tuple(tensor.shape) for name, tensor in tensors.items()}
    for name in sorted({*wanted, *found}):
        if wanted.get(name) != found.get(name):
            raise ModelError(
                f'model {path}: tensor {name} has shape {found.get(name)}, but {_WANTED} with its'
                f' configuration needs {wanted.get(name)}: {_REMEDY}'
            )
        if not bool(tensors[name].isfinite().all()):
            raise ModelError(
                f'model {path}: tensor {name} holds numbers that are not finite: {_REMEDY}'
            )
