# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Weight files and model cards of trained networks."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from mixtac_fger.config import ConfigError, ModelError
from mixtac_fger.weights import ModelCard, read_tensors, write_tensors
from mixtac_learning.paper.config import PaperConfig
from mixtac_learning.paper.networks import build

if TYPE_CHECKING:
    from pathlib import Path

    from mixtac_learning.paper.networks import PaperNetwork


PAPER_ARCHITECTURE = 'fger_paper'
PAPER_VERSION = '1'
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
        'architecture': PAPER_ARCHITECTURE,
        'version': PAPER_VERSION,
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
    if found != (PAPER_ARCHITECTURE, PAPER_VERSION):
        raise ModelError(
            f'{path} holds {found}, not {PAPER_ARCHITECTURE} version {PAPER_VERSION}: {_REMEDY}'
        )
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


_SIMULATED = (
    '**Trained on simulated data only.** What it is worth on a real sensor is unknown: train on'
    " your own sensor's recordings before you rely on it."
)


def write_model_card(path: Path, name: str, card: ModelCard) -> None:
    """Write the card.

    Args:
        path: Markdown file.
        name: Name of the weight file.
        card: What it says.
    """
    path.write_text(model_card(name, card), encoding='utf-8')


def model_card(name: str, card: ModelCard) -> str:
    """Return the card as Markdown."""
    training = dict(card.training)
    settings = training.pop('settings', {})
    simulated = str(training.get('data', '')).startswith('simulated')
    parts = [f'# Model card: `{name}`', '']
    if simulated:
        parts += [
            _SIMULATED,
            '',
        ]
    parts += ['## Training', '', *_pairs(training), '', '## Settings', '', *_pairs(settings)]
    for title, figures in card.metrics.items():
        parts += ['', f'## Figures: {title.replace("_", " ")}', '', *_table(figures)]
    return '\n'.join(parts) + '\n'


def _pairs(values: dict[str, Any]) -> list[str]:
    rows = [f'| {key.replace("_", " ")} | {_text(value)} |' for key, value in values.items()]
    return ['| what | value |', '|---|---|', *rows]


def _table(figures: dict[str, Any]) -> list[str]:
    rows = {key: row for key, row in figures.items() if isinstance(row, dict)}
    columns = list(dict.fromkeys(name for row in rows.values() for name in row))
    if not columns:
        return _pairs(figures)
    head = ' | '.join(['profile', *(name.replace('_', ' ') for name in columns)])
    lines = [f'| {head} |', '|---' + '|---:' * len(columns) + '|']
    for key, row in rows.items():
        cells = ' | '.join([key, *(_text(row.get(name, '-')) for name in columns)])
        lines.append(f'| {cells} |')
    return lines


def _text(value: Any) -> str:  # noqa: ANN401
    if isinstance(value, dict):
        return '; '.join(f'{k}: {_text(v)}' for k, v in value.items()) or 'none'
    if isinstance(value, (list, tuple)):
        return ', '.join(map(str, value)) or 'none'
    return str(value)
