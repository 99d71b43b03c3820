# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""How all figures of the experiments look."""

from __future__ import annotations

from typing import TYPE_CHECKING

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from mixtac_bringup.experiments.study import EVENTS, FGER, FRAMES, FUSION
from mixtac_fger.train.run_config import OURS

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes

COLOURS = {
    'truth': '#1f1f1f',
    'paper': '#8a8a8a',
    OURS: '#0072b2',
    FGER: '#009e73',
    FRAMES: '#e69f00',
    EVENTS: '#d55e00',
    FUSION: '#cc79a7',
}
"""By model; told apart without colour vision (Okabe and Ito 2008)."""
DPI = 110


def new_figure(
    columns: int = 1, rows: int = 1, width: float = 8.0, height: float = 3.4
) -> tuple[Figure, list[Axes]]:
    """Return a figure and its axes, row by row; sizes in inches."""
    figure = Figure(figsize=(width, height), layout='constrained')
    axes = figure.subplots(rows, columns, squeeze=False)
    flat = [ax for row in axes for ax in row]
    for ax in flat:
        ax.spines[['top', 'right']].set_visible(False)
        ax.grid(visible=True, alpha=0.25, linewidth=0.6)
        ax.set_axisbelow(True)
    return figure, flat


def save_figure(figure: Figure, path: Path) -> Path:
    """Write a figure and return where."""
    FigureCanvasAgg(figure)
    figure.savefig(path, dpi=DPI)
    return path


def mark(simulated: bool) -> str:
    """Return what titles say of where the data come from."""
    return 'simulated' if simulated else 'recorded'
