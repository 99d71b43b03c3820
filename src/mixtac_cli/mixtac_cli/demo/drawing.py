# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The figure of a demo: normal force, error, events, its phases enlarged, and the second part."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mixtac_cli.figures import EVENTS, FORCE, REFERENCE, new_figure, save_figure

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.gridspec import SubplotSpec
    from numpy.typing import NDArray

    from mixtac_cli.demo.evaluation import Comparison
    from mixtac_cli.demo.sideways import SidewaysRun


def draw_run(
    path: Path,
    comparison: Comparison,
    rate: tuple[NDArray[np.float64], NDArray[np.float64]],
    spans: list[tuple[str, float, float]],
    title: str,
    sideways: SidewaysRun,
) -> None:
    """Save a figure of a run.

    Args:
        path: File to write; its suffix gives the format.
        comparison: Estimate and aligned reference.
        rate: Times [s] and event rates [1/s], times as in `comparison`.
        spans: Named spans (label, start s, end s) to show enlarged.
        title: Title; says that the data are simulated if they are.
        sideways: The second part.

    Raises:
        FileError: The file cannot be written.
    """
    figure = new_figure(11, 10.5)
    columns = max(1, len(spans))
    grid = figure.add_gridspec(5, 3 * columns, height_ratios=[3, 1, 1, 3, 3])
    whole = figure.add_subplot(grid[0, :])
    _force(whole, comparison, 0.0, float(comparison.time_s[-1]))
    top = 1.3 * float(np.quantile(comparison.reference_n, 0.99))
    whole.set_ylim(-0.15, max(1.2, top))
    whole.legend(loc='upper right', ncols=2, frameon=False)
    whole.set_title(title, loc='left')
    error = figure.add_subplot(grid[1, :], sharex=whole)
    difference_n = comparison.estimate_n - comparison.reference_n
    error.plot(comparison.time_s, difference_n, color=FORCE, lw=0.7)
    error.axhline(0, color='k', lw=0.5)
    error.set(ylabel='error [N]', ylim=(-0.5, 0.5))
    events = figure.add_subplot(grid[2, :], sharex=whole)
    events.semilogy(rate[0], np.maximum(rate[1], 1.0), color=EVENTS, lw=0.8)
    events.set(xlabel='camera time [s]', ylabel='events [1/s]')
    for column, (label, start, end) in enumerate(spans):
        axes = figure.add_subplot(grid[3, 3 * column : 3 * column + 3])
        _force(axes, comparison, start, end)
        axes.set_title(label, fontsize=10)
        axes.set_xlabel('camera time [s]')
    _sideways(figure, grid[4, : 2 * columns], grid[4, 2 * columns :], sideways)
    save_figure(figure, path)


def _force(axes: Axes, comparison: Comparison, start: float, end: float) -> None:
    shown = (comparison.time_s >= start) & (comparison.time_s <= end)
    time = comparison.time_s[shown]
    axes.plot(time, comparison.reference_n[shown], color=REFERENCE, lw=1.4, label='reference')
    axes.plot(time, comparison.estimate_n[shown], color=FORCE, lw=1.0, label='estimate')
    axes.set(ylabel='normal force [N]', xlim=(start, end))
    axes.grid(visible=True, alpha=0.25)


def _sideways(
    figure: Figure, forces_at: SubplotSpec, places_at: SubplotSpec, run: SidewaysRun
) -> None:
    """Draw the second part: sideways force over time, and places of the contact."""
    forces = figure.add_subplot(forces_at)
    for axis, (name, style) in enumerate((('right', '-'), ('up', '--'))):
        truth, found = run.truth_n[:, axis], run.force_n[:, axis]
        forces.plot(run.time_s, truth, style, color=REFERENCE, lw=1.4, label=f'{name}, simulated')
        forces.plot(run.time_s, found, style, color=FORCE, lw=1.0, label=f'{name}, estimate')
    forces.set(xlabel='time of the second part [s]', ylabel='sideways force [N]')
    forces.set_title('a pull, then a roll', fontsize=10)
    forces.legend(frameon=False, fontsize=8, ncols=2)
    forces.grid(visible=True, alpha=0.25)
    skin = figure.add_subplot(places_at)
    skin.plot(*run.path_mm.T, color=REFERENCE, lw=3.0, label='simulated path')
    skin.plot(*run.place_mm.T, '.', color=FORCE, ms=1.5, label='estimate')
    skin.set(xlabel='right [mm]', ylabel='up [mm]')
    skin.set_aspect('equal', 'datalim')
    skin.set_title('place of the contact', fontsize=10)
    skin.legend(frameon=False, fontsize=8)
    skin.grid(visible=True, alpha=0.25)
