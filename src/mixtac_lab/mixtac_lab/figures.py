# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Figures, tables and files in which experiments and benchmarks show their results."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.markup import escape
from rich.table import Table

from mixtac_node.files import write_json

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from mixtac_learning.judge.estimators import TrialEstimate


TRUTH, PAPER = '#1f1f1f', '#8a8a8a'
"""Colours of the true force and of the paper's values."""
DPI = 110


def make_table(title: str, headings: Sequence[str], rows: Iterable[Sequence[object]]) -> Table:
    """Return a table; the first column is aligned to the left, values to the right."""
    table = Table(title=escape(title), title_justify='left')
    for number, heading in enumerate(headings):
        table.add_column(escape(heading), justify='right' if number else 'left')
    for row in rows:
        table.add_row(*(escape(str(cell)) for cell in row))
    return table


def new_figure(
    columns: int = 1, rows: int = 1, width: float = 8.0, height: float = 3.4
) -> tuple[Figure, list[Axes]]:
    """Return a figure and its axes, row by row; sizes in inches."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout='constrained')
    axes = figure.subplots(rows, columns, squeeze=False)
    flat = [ax for row in axes for ax in row]
    for ax in flat:
        ax.spines[['top', 'right']].set_visible(False)
        ax.grid(visible=True, alpha=0.25, linewidth=0.6)
        ax.set_axisbelow(True)
    return figure, flat


def save_figure(figure: Figure, path: Path) -> Path:
    """Write a figure and return its path; makes the folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=DPI)
    return path


def save_result(path: Path | None, result: dict[str, Any]) -> None:
    """Write a result to the JSON file that the user asked for, if any."""
    if path is not None:
        write_json(path, result)


def mark(simulated: bool) -> str:
    """Return the word for the origin of the data in titles."""
    return 'simulated' if simulated else 'recorded'


def plot_forces(
    ax: Axes,
    known: TrialEstimate,
    curves: Mapping[Any, TrialEstimate],
    origin_us: float,
    span_s: tuple[float, float],
    *,
    simulated: bool,
) -> None:
    """Plot estimates of one trial over the known force.

    Args:
        ax: Axes.
        known: Any estimate of the trial.
        curves: Estimates by how their models appear (`label` and `colour`).
        origin_us: Time zero of the plot, camera clock [us].
        span_s: Part that is shown [s].
        simulated: Whether the trial is simulated.
    """
    name = 'true force' if simulated else 'reference'
    lines = [(known.t_us, known.known, name, TRUTH, 2.2)]
    lines += [(e.t_us, e.force, look.label, look.colour, 1.1) for look, e in curves.items()]
    for t_us, force, label, colour, width in lines:
        t_s = 1e-6 * (t_us - origin_us)
        shown = (t_s >= span_s[0]) & (t_s <= span_s[1])
        ax.plot(t_s[shown], force[shown], color=colour, label=label, lw=width, alpha=0.9)
    ax.set_xlim(*span_s)
