# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Weight files and model cards: their search path and their format.

A weight file is a safetensors file whose header names the architecture and its version and contains
the configuration, the origin of the training data, and results on data that were not used for
training.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from mixtac_core.events.errors import MixtacError
from mixtac_core.node.files import replacing, share, write_text
from mixtac_fger.config import ModelError

Tensors = Mapping[str, NDArray[Any]]
"""Arrays by name."""
DEFAULT_MODEL = 'fger_small'
SUFFIX = '.safetensors'


def shipped_models() -> Path:
    """Return the folder of the models that come with the package."""
    return share('mixtac_fger') / 'models'


def find_model(name: str) -> Path:
    """Return the file that `name` means; it may not exist (`read_model` checks that).

    Args:
        name: A path (with a folder or the suffix `.safetensors`), or a name like `fger_small`.
    """
    path = Path(name).expanduser()
    if path.suffix == SUFFIX or len(path.parts) > 1:
        shipped = shipped_models() / path
        return shipped if len(path.parts) == 1 and not path.exists() else path
    return shipped_models() / (name + SUFFIX)


def write_tensors(path: Path, tensors: Tensors, header: Mapping[str, str]) -> None:
    """Write a safetensors file; an existing one is replaced only once the new one is complete.

    Args:
        path: File; its folder is made if need be.
        tensors: Arrays by name.
        header: Texts by name.

    Raises:
        FileError: It cannot be written.
    """
    from safetensors.numpy import save_file

    # Contiguous copies: safetensors would write the memory of a view as it lies.
    whole = {name: np.array(tensor, order='C') for name, tensor in tensors.items()}
    with replacing(path) as scratch:
        save_file(whole, scratch, metadata=dict(header))


def read_tensors(
    path: Path, error_type: type[MixtacError], remedy: str
) -> tuple[dict[str, str], dict[str, NDArray[Any]]]:
    """Return header and tensors of a safetensors file.

    Args:
        path: File.
        error_type: Raised where the file is missing or damaged.
        remedy: Of that error.
    """
    from safetensors import SafetensorError, safe_open

    if not path.is_file():
        raise error_type(f'{path} does not exist', remedy=remedy)
    try:
        with safe_open(path, framework='np') as file:
            return file.metadata() or {}, {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    # NumPy has no bfloat16 and no float8, which safetensors meets with one of the last two.
    except (SafetensorError, OSError, TypeError, AttributeError) as error:
        text = ' '.join(str(error).split())
        raise error_type(f'{path} cannot be read as safetensors ({text})', remedy=remedy) from error


MODEL_REMEDY = 'train one with "mixtac train" or use the model that comes with the package'


@dataclass(frozen=True, slots=True)
class ModelCard:
    """The description of a model in its weight file.

    Attributes:
        training: Where the training data came from (seeds, trials, labels) and how it was trained.
        metrics: Figures on data that were not trained on.
    """

    training: dict[str, Any] = field(default_factory=dict)
    metrics: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """The content of a weight file, of any architecture.

    `mixtac_fger.estimator.open_estimator` makes an estimator of it.

    Attributes:
        architecture: Name under which its estimator is registered.
        version: Version of the architecture.
        config: Configuration of the network, JSON-ready.
        card: Description.
        tensors: Weights by name.
    """

    architecture: str
    version: int
    config: dict[str, Any]
    card: ModelCard
    tensors: Tensors


def write_model(path: Path, model: Model) -> None:
    """Write a weight file; an existing file is replaced only once the new one is complete.

    Raises:
        FileError: It cannot be written.
    """
    header = {
        'architecture': model.architecture,
        'version': str(model.version),
        'config': json.dumps(model.config),
        'training': json.dumps(model.card.training),
        'metrics': json.dumps(model.card.metrics),
    }
    write_tensors(path, model.tensors, header)


def read_model(path: Path) -> Model:
    """Read a weight file of any architecture.

    Args:
        path: A file written by `write_model`.

    Raises:
        ModelError: The file is missing or damaged, its header is incomplete, or its tensors hold
            numbers that are not finite.
    """
    header, tensors = read_tensors(path, ModelError, MODEL_REMEDY)
    if 'architecture' not in header:
        raise ModelError(f'{path} is not a Mixtac weight file', remedy=MODEL_REMEDY)
    try:
        config, training, metrics = (
            dict(json.loads(header[name])) for name in ('config', 'training', 'metrics')
        )
        version = int(header['version'])
    except (KeyError, ValueError, TypeError, RecursionError) as error:
        raise ModelError(
            f'{path}, of architecture {header["architecture"]!r}, has a header that cannot be used '
            f'({error})',
            remedy=MODEL_REMEDY,
        ) from error
    for name, tensor in tensors.items():
        if not np.isfinite(tensor).all():
            raise ModelError(
                f'{path}: tensor {name} holds numbers that are not finite', remedy=MODEL_REMEDY
            )
    return Model(header['architecture'], version, config, ModelCard(training, metrics), tensors)


_SIMULATED = (
    '**Trained on simulated data only.** What it is worth on a real sensor is unknown: train on'
    " your own sensor's recordings before you rely on it."
)


def save_model(path: Path, model: Model) -> None:
    """Write a weight file and its model card, a text file of the same name.

    Args:
        path: Weight file; its suffix is `.safetensors`.
        model: Its content.
    """
    write_model(path, model)
    write_text(path.with_suffix('.md'), model_card(path.name, model.card))


def model_card(name: str, card: ModelCard) -> str:
    """Return the card as Markdown, with a block of YAML per section."""
    parts = [f'# Model card: `{name}`']
    if str(card.training.get('data', '')).startswith('simulated'):
        parts.append(_SIMULATED)
    for title, content in {'training': card.training, **card.metrics}.items():
        plain = json.loads(json.dumps(content))
        text = yaml.safe_dump(plain, sort_keys=False, default_flow_style=None, width=110)
        parts.append(f'## {title.replace("_", " ").capitalize()}\n\n```yaml\n{text}```')
    return '\n\n'.join(parts) + '\n'
