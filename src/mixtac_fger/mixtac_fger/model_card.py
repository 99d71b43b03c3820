# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Model cards: what a weight file holds, as a text for people."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mixtac_fger.weights import Model, ModelCard, write_model
from mixtac_node.files import write_text

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
    """Return the card as Markdown."""
    training = dict(card.training)
    settings = training.pop('settings', {})
    simulated = str(training.get('data', '')).startswith('simulated')
    parts = [f'# Model card: `{name}`', '', *([_SIMULATED, ''] if simulated else [])]
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
