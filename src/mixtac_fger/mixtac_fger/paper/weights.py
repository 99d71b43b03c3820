# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Weight files of the paper's networks."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mixtac_fger.errors import ConfigError, ModelError
from mixtac_fger.paper.config import PaperConfig
from mixtac_fger.paper.models import build
from mixtac_fger.tensor_file import read_tensors, write_tensors
from mixtac_fger.weights import ModelCard

if TYPE_CHECKING:
    from pathlib import Path

    from mixtac_fger.paper.models import PaperNetwork

ARCHITECTURE = 'fger_paper'
VERSION = '1'
_REMEDY = 'train one with "mixtac train fger_paper"'


@dataclass(frozen=True, slots=True)
class LoadedPaperModel:
    """A network that is ready to use.

    Attributes:
        network: In evaluation mode, on the CPU.
        card: What the file says of itself.
    """

    network: PaperNetwork
    card: ModelCard


def save_paper_model(path: Path, network: PaperNetwork, card: ModelCard) -> None:
    """Write a weight file; an existing one is replaced only once the new one is complete."""
    header = {
        'architecture': ARCHITECTURE,
        'version': VERSION,
        'config': json.dumps(network.config.to_dict()),
        'training': json.dumps(card.training),
        'metrics': json.dumps(card.metrics),
    }
    write_tensors(path, dict(network.state_dict()), header)


def load_paper_model(path: Path) -> LoadedPaperModel:
    """Read a weight file and check it.

    Raises:
        ModelError: It is missing or damaged, of another architecture, or its tensors do not fit.
    """
    header, tensors = read_tensors(path, ModelError, _REMEDY)
    found = (header.get('architecture'), header.get('version'))
    if found != (ARCHITECTURE, VERSION):
        raise ModelError(f'{path} holds {found}, not {ARCHITECTURE} version {VERSION}: {_REMEDY}')
    try:
        network = build(PaperConfig.from_dict(json.loads(header['config'])))
        card = ModelCard(json.loads(header['training']), json.loads(header['metrics']))
        network.load_state_dict(tensors)
    except (KeyError, ValueError, TypeError, RuntimeError, ConfigError) as error:
        text = ' '.join(str(error).split())
        raise ModelError(f'{path} cannot be used ({text}): {_REMEDY}') from error
    return LoadedPaperModel(network.eval(), card)


def architecture_of(path: Path) -> str:
    """Return the architecture that a weight file names, empty where it names none.

    Raises:
        ModelError: It is missing or damaged.
    """
    from safetensors import SafetensorError, safe_open

    if not path.is_file():
        raise ModelError(f'model {path} does not exist: train one with "mixtac train"')
    try:
        with safe_open(path, framework='np') as file:
            return str((file.metadata() or {}).get('architecture', ''))
    except (SafetensorError, OSError) as error:
        raise ModelError(f'model {path} is not a safetensors file ({error})') from error
