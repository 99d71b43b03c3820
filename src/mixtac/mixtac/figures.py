# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Figures and tables of commands."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.table import Table
from rich.text import Text

from mixtac_core.node.files import FileError, replacing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FORCE = '#e07b00'  # colours, by what is drawn
REFERENCE = '#1f4e8c'
EVENTS = '#5a5a5a'
TRUTH = '#1f1f1f'
PAPER = '#8a8a8a'
DPI = 110


def make_table(
    title: str, headings: Sequence[str], rows: Iterable[Sequence[object]], *, words: int = 1
) -> Table:
    """Return a table; its first `words` columns are aligned to the left, values to the right."""
    # Names may hold square brackets.
    table = Table(title=Text(title, 'table.title') if title else None, title_justify='left')
    for number, heading in enumerate(headings):
        table.add_column(Text(heading), justify='left' if number < words else 'right')
    for row in rows:
        table.add_row(*(Text(str(cell)) for cell in row))
    return table


def new_axes(
    columns: int = 1, rows: int = 1, width: float = 8.0, height: float = 3.4
) -> tuple[Figure, list[Axes]]:
    """Return a figure, which needs no display, and its axes row by row; sizes in inches."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout='constrained')
    flat = list(figure.subplots(rows, columns, squeeze=False).flat)
    for ax in flat:
        ax.spines[['top', 'right']].set_visible(False)
        ax.grid(visible=True, alpha=0.25, linewidth=0.6)
        ax.set_axisbelow(True)
    return figure, flat


def save_figure(figure: Figure, path: Path) -> Path:
    """Save a figure and return its path; its suffix gives the format.

    Raises:
        FileError: The file cannot be written, or its suffix is not that of a format.
    """
    try:
        with replacing(path) as scratch:
            figure.savefig(scratch, dpi=DPI)
    except ValueError as error:
        raise FileError(
            f'cannot write {path}: {error}', remedy='name a .png or .pdf file'
        ) from error
    return path
