# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Weight files: where models are found, and what their header and tensors have to be.

A weight file is a safetensors file whose header names the architecture and its version and holds
the configuration, where the training data came from, and figures on data that were not trained on.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mixtac_fger.config import ARCHITECTURE, VERSION, ConfigError, FgerConfig, ModelError
from mixtac_learning.network import FgerNetwork

if TYPE_CHECKING:
    from torch import Tensor

    from mixtac_events.errors import MixtacError


DEFAULT_MODEL = 'fger_small'
SUFFIX = '.safetensors'


def shipped_models() -> Path:
    """Return the folder of the models that come with the package."""
    try:
        from ament_index_python.packages import get_package_share_directory

        return Path(get_package_share_directory('mixtac_fger')) / 'models'
    except (ImportError, LookupError, OSError):  # no ROS, or none that knows this package
        return Path(__file__).resolve().parents[1] / 'models'


def find_model(name: str) -> Path:
    """Return the file that `name` means; it may not exist (`load_model` says so).

    Args:
        name: A path (with a folder or the suffix `.safetensors`), or a name like `fger_small`.
    """
    path = Path(name).expanduser()
    if path.suffix == SUFFIX or len(path.parts) > 1:
        shipped = shipped_models() / path
        return shipped if len(path.parts) == 1 and not path.exists() else path
    return shipped_models() / (name + SUFFIX)


def write_tensors(path: Path, tensors: dict[str, Tensor], header: dict[str, str]) -> None:
    """Write a file; an existing one is replaced only once the new one is complete.

    Args:
        path: File; its folder is made if need be.
        tensors: By name.
        header: Texts by name.
    """
    from safetensors.torch import save_file

    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(path.name + '.partial')
    # Copies: safetensors refuses tensors that share memory.
    kept = {name: tensor.detach().cpu().contiguous().clone() for name, tensor in tensors.items()}
    save_file(kept, partial, metadata=header)
    partial.replace(path)


def read_tensors(
    path: Path, error_type: type[MixtacError], remedy: str
) -> tuple[dict[str, str], dict[str, Tensor]]:
    """Return header and tensors of a file.

    Args:
        path: File.
        error_type: Raised where the file is missing or damaged.
        remedy: What to do then, the end of that error's text.
    """
    from safetensors import SafetensorError, safe_open

    if not path.is_file():
        raise error_type(f'{path} does not exist: {remedy}')
    try:
        with safe_open(path, framework='pt') as file:
            return file.metadata() or {}, {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError) as error:
        raise error_type(f'{path} is not a safetensors file ({error}): {remedy}') from error


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
