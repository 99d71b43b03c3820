# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The figure of a demo: normal force, error, events, and its phases enlarged."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mixtac_cli.figures import EVENTS, FORCE, REFERENCE, new_figure, save_figure

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from mixtac_cli.demo.evaluation import Comparison


def draw_run(
    path: Path,
    comparison: Comparison,
    rate: tuple[NDArray[np.float64], NDArray[np.float64]],
    spans: list[tuple[str, float, float]],
    title: str,
) -> None:
    """Save a figure of a run.

    Args:
        path: File to write; its suffix gives the format.
        comparison: Estimate and aligned reference.
        rate: Times [s] and event rates [1/s], times as in `comparison`.
        spans: Named spans (label, start s, end s) to show enlarged.
        title: Title; says that the data are simulated if they are.

    Raises:
        FileError: The file cannot be written.
    """
    figure = new_figure(11, 8.5)
    columns = max(1, len(spans))
    grid = figure.add_gridspec(4, columns, height_ratios=[3, 1, 1, 3])
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
        axes = figure.add_subplot(grid[3, column])
        _force(axes, comparison, start, end)
        axes.set_title(label, fontsize=10)
        axes.set_xlabel('camera time [s]')
    save_figure(figure, path)


def _force(axes: Axes, comparison: Comparison, start: float, end: float) -> None:
    shown = (comparison.time_s >= start) & (comparison.time_s <= end)
    time = comparison.time_s[shown]
    axes.plot(time, comparison.reference_n[shown], color=REFERENCE, lw=1.4, label='reference')
    axes.plot(time, comparison.estimate_n[shown], color=FORCE, lw=1.0, label='estimate')
    axes.set(ylabel='normal force [N]', xlim=(start, end))
    axes.grid(visible=True, alpha=0.25)
