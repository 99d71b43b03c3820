# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Which views the page shows, and where."""

from __future__ import annotations

from typing import Any

import rerun.blueprint as rrb

TIMELINE = 'received'
"""Arrival at the view on the host clock: the one axis that all sensors have in common."""


def layout(history_s: float, *, slip: bool) -> Any:  # noqa: ANN401
    """Return the blueprint: events above frame, plots in the middle, what the nodes say right.

    Args:
        history_s: Width of the plots [s].
        slip: With a plot of the slip detection, for graphs that run it.
    """
    pictures = rrb.Vertical(
        rrb.Spatial2DView(origin='events', name='Events: blue brighter, orange darker'),
        rrb.Spatial2DView(origin='frame', name='APS frame'),
    )
    plots = [
        _plot('force', 'Normal force [N]', history_s),
        _plot('rates', 'Rates [1/s]', history_s),
    ]
    if slip:
        plots.insert(1, _plot('slip', 'Slip: events per window', history_s))
    return rrb.Blueprint(
        rrb.Horizontal(
            pictures,
            rrb.Vertical(*plots, row_shares=[2, *[1] * (len(plots) - 1)]),
            rrb.TextDocumentView(origin='state', name='State'),
            column_shares=[3, 5, 3],
        ),
        rrb.TimePanel(state='collapsed', timeline=TIMELINE, play_state='following'),
        collapse_panels=True,
        auto_views=False,
    )


def _plot(origin: str, name: str, history_s: float) -> Any:  # noqa: ANN401
    boundary = rrb.TimeRangeBoundary
    return rrb.TimeSeriesView(
        origin=origin,
        name=name,
        plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.LeftTop),
        time_ranges=rrb.VisibleTimeRange(
            TIMELINE,
            start=boundary.cursor_relative(seconds=-history_s),
            end=boundary.cursor_relative(),
        ),
    )
