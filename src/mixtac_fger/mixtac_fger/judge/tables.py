# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Figures of models as tables on the terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rich.table import Table

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from rich.console import Console

COLUMNS = (
    'mae',
    'rmse',
    'r2',
    'calibrated_mae',
    'frames_only_mae',
    'constant_mae',
    'reference_mae',
    'peak_error',
    'fast_mae',
    'rolling_worst_mae',
    'coverage_68',
    'coverage_95',
)
"""Of `mixtac_fger.judge.summary`, in the order shown; those that no row has are left out."""
_FIGURE = len('-0.000')
_BORDERS = 4
"""Characters of a table's edges and of the space about its first column."""


def show_figures(console: Console, title: str, figures: Mapping[str, Mapping[str, Any]]) -> None:
    """Print figures, one row per profile; in several tables where the terminal is narrow."""
    shown = [name for name in COLUMNS if any(name in row for row in figures.values())]
    for names in _fitting(shown, console.width - max(map(len, ['profile', *figures]))):
        table = Table(title=title, title_justify='left')
        table.add_column('profile', no_wrap=True)
        for name in names:
            table.add_column(name.replace('_', ' '), justify='right', min_width=_width(name))
        for profile, row in figures.items():
            table.add_row(profile, *(f'{row[c]:.3f}' if c in row else '-' for c in names))
        console.print(table)


def _width(name: str) -> int:
    """Return the characters that a column needs: its longest word, or a figure."""
    return max(_FIGURE, *map(len, name.split('_')))


def _fitting(names: Sequence[str], width: int) -> Iterator[list[str]]:
    """Yield the columns in parts of which each fits into a width, at least one at a time."""
    part: list[str] = []
    left = width - _BORDERS
    for name in names:
        needed = _width(name) + _BORDERS - 1
        if part and needed > left:
            yield part
            part, left = [], width - _BORDERS
        part.append(name)
        left -= needed
    if part:
        yield part


def show_skipped(console: Console, skipped: Mapping[str, str]) -> None:
    """Print which trials were left out and why."""
    for name, reason in skipped.items():
        console.print(f'[yellow]left out[/yellow] {name}: {reason}', highlight=False)
