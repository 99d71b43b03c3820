# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Figures of models as tables on the terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rich.table import Table

if TYPE_CHECKING:
    from collections.abc import Mapping

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


def show_figures(console: Console, title: str, figures: Mapping[str, Mapping[str, Any]]) -> None:
    """Print figures, one row per profile."""
    table = Table(title=title, title_justify='left')
    shown = [name for name in COLUMNS if any(name in row for row in figures.values())]
    table.add_column('profile')
    for name in shown:
        table.add_column(name.replace('_', ' '), justify='right')
    for profile, row in figures.items():
        table.add_row(profile, *(f'{row[c]:.3f}' if c in row else '-' for c in shown))
    console.print(table)


def show_skipped(console: Console, skipped: Mapping[str, str]) -> None:
    """Print which trials were left out and why."""
    for name, reason in skipped.items():
        console.print(f'[yellow]left out[/yellow] {name}: {reason}', highlight=False)
