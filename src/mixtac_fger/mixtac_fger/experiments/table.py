# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The table of all models: mean and spread over training seeds."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from rich.table import Table

from mixtac_fger.experiments.suite import ALL_ROWS

if TYPE_CHECKING:
    from collections.abc import Sequence

FIGURES = (
    'mae',
    'rmse',
    'r2',
    'reference_mae',
    'peak_error',
    'fast_mae',
    'rolling_worst_mae',
    'coverage_68',
    'coverage_95',
)


def aggregate(results: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return, per model and column, mean and standard deviation over the seeds.

    Args:
        results: Of `Job.carry_out`.

    Returns:
        model -> column -> figure -> `mean`, `spread`, `seeds`; the spread of one seed is 0.
    """
    table: dict[str, Any] = {}
    for model in ALL_ROWS:
        found = [each['figures'] for each in results if each['model'] == model]
        if not found:
            continue
        columns = list(dict.fromkeys(name for figures in found for name in figures))
        table[model] = {
            column: {
                figure: _spread([f[column][figure] for f in found if figure in f.get(column, {})])
                for figure in FIGURES
                if any(figure in f.get(column, {}) for f in found)
            }
            for column in columns
        }
    return table


def _spread(values: list[float]) -> dict[str, float]:
    deviation = float(np.std(values, ddof=1)) if len(values) > 1 else 0.0
    mean = float(np.mean(values))
    return {'mean': round(mean, 4), 'spread': round(deviation, 4), 'seeds': len(values)}


def as_table(aggregated: dict[str, Any], title: str, figure: str = 'mae') -> Table:
    """Return one figure of all models for the terminal, one column per model."""
    table = Table(title=title, title_justify='left')
    table.add_column('judged on')
    for model in aggregated:
        table.add_column(model.replace('_', ' '), justify='right')
    for name in dict.fromkeys(name for row in aggregated.values() for name in row):
        cells = [_cell(row.get(name, {}).get(figure)) for row in aggregated.values()]
        table.add_row(name.replace('_', ' '), *cells)
    return table


def as_markdown(aggregated: dict[str, Any], figure: str = 'mae') -> str:
    """Return the same as Markdown."""
    columns = list(dict.fromkeys(name for row in aggregated.values() for name in row))
    head = ' | '.join(['model', *(name.replace('_', ' ') for name in columns)])
    lines = [f'| {head} |', '|---' + '|---:' * len(columns) + '|']
    for model, row in aggregated.items():
        cells = [_cell(row.get(name, {}).get(figure)) for name in columns]
        lines.append(f'| {" | ".join([model, *cells])} |')
    return '\n'.join(lines) + '\n'


def _cell(value: dict[str, float] | None) -> str:
    if value is None:
        return '-'
    spread = f' +-{value["spread"]:.3f}' if value['seeds'] > 1 else ''
    return f'{value["mean"]:.3f}{spread}'
