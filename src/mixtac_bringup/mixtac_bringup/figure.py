# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The picture of a run: estimate against reference, error, event rate."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from mixtac_bringup.evaluation import Comparison

REFERENCE_COLOUR, ESTIMATE_COLOUR, EVENT_COLOUR = '#1f4e8c', '#e07b00', '#5a5a5a'


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
        title: Title; says that the data are simulated where they are.
    """
    import matplotlib as mpl

    mpl.use('Agg')
    from matplotlib import pyplot as plt

    figure = plt.figure(figsize=(11, 8), layout='constrained')
    grid = figure.add_gridspec(4, max(1, len(spans)), height_ratios=[3, 1, 1, 3])
    whole = figure.add_subplot(grid[0, :])
    _force(whole, comparison, 0.0, float(comparison.time_s[-1]))
    top = 1.3 * float(np.quantile(comparison.reference_n, 0.99))
    whole.set_ylim(-0.15, max(1.2, top))
    whole.legend(loc='upper right', ncols=2, frameon=False)
    whole.set_title(title, loc='left')
    error = figure.add_subplot(grid[1, :], sharex=whole)
    error.plot(
        comparison.time_s,
        comparison.estimate_n - comparison.reference_n,
        color=ESTIMATE_COLOUR,
        lw=0.7,
    )
    error.axhline(0, color='k', lw=0.5)
    error.set_ylabel('error [N]')
    error.set_ylim(-0.5, 0.5)
    events = figure.add_subplot(grid[2, :], sharex=whole)
    events.semilogy(rate[0], np.maximum(rate[1], 1.0), color=EVENT_COLOUR, lw=0.8)
    events.set_ylabel('events [1/s]')
    events.set_xlabel('camera time [s]')
    for column, (label, start, end) in enumerate(spans):
        axes = figure.add_subplot(grid[3, column])
        _force(axes, comparison, start, end)
        axes.set_title(label, fontsize=10)
        axes.set_xlabel('camera time [s]')
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _force(axes: Axes, comparison: Comparison, start: float, end: float) -> None:
    shown = (comparison.time_s >= start) & (comparison.time_s <= end)
    time = comparison.time_s[shown]
    axes.plot(
        time, comparison.reference_n[shown], color=REFERENCE_COLOUR, lw=1.4, label='reference'
    )
    axes.plot(time, comparison.estimate_n[shown], color=ESTIMATE_COLOUR, lw=1.0, label='estimate')
    axes.set_ylabel('normal force [N]')
    axes.set_xlim(start, end)
    axes.grid(visible=True, alpha=0.25)
