# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The page of the live view in rerun; the only module that imports rerun."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

Colour = tuple[int, int, int]


TIMELINE = 'received'
"""Arrival at the view on the host clock, which all topics have in common."""


def layout(history_s: float, *, slip: bool) -> Any:  # noqa: ANN401
    """Return the blueprint: events above frame, plots in the middle, diagnostics at the right.

    Args:
        history_s: Width of the plots [s].
        slip: Add a plot of the slip detection.
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


LINES = {
    'force/estimate': ('estimate', (0, 158, 115)),
    'force/reference': ('reference', (230, 159, 0)),
    'slip/count': ('count', (86, 180, 233)),
    'slip/threshold': ('threshold', (213, 94, 0)),
    'rates/events': ('events / 1000', (86, 180, 233)),
    'rates/packets': ('packets', (240, 228, 66)),
    'rates/frames': ('frames', (204, 121, 167)),
    'rates/force': ('force', (0, 158, 115)),
    'rates/reference': ('reference', (230, 159, 0)),
}
"""Name in the legend and colour of each plotted line, by its path."""


CONTACT, FIELD = (240, 228, 66), (86, 180, 233)
"""Colours of the outline of the contact and of the displacement."""


class Page:
    """A stream of drawings to the viewer's server, or to a file.

    Args:
        history_s: Width of the plots [s].
        colours: Colour of each level of the event pictures.
        url: Address at which the server receives data.
        path: New .rrd file to write instead of sending.
    """

    def __init__(
        self,
        history_s: float,
        colours: Mapping[int, Colour],
        url: str = '',
        path: Path | None = None,
    ) -> None:
        self._history_s = history_s
        self._with_slip = False
        self._stream = rr.RecordingStream('mixtac')
        blueprint = layout(history_s, slip=False)
        if path is not None:
            self._stream.save(path, default_blueprint=blueprint)
        else:
            self._stream.connect_grpc(url, default_blueprint=blueprint)
        classes = [rr.AnnotationInfo(level, color=each) for level, each in colours.items()]
        self._stream.log('events', rr.AnnotationContext(classes), static=True)
        for entity, (name, colour) in LINES.items():
            line = rr.SeriesLines(colors=[colour], names=[name], widths=[1.5])
            self._stream.log(entity, line, static=True)

    def at(self, time_ns: int) -> None:
        """Set the time of the next pictures and texts [ns, host clock]."""
        self._stream.set_time(TIMELINE, timestamp=time_ns * 1e-9)

    def events(self, levels: NDArray[np.uint8]) -> None:
        """Show a picture of events, levels of `event_picture` [height, width]."""
        # Not compressed: browsers decompress slowly and show nothing until then.
        self._stream.log('events', rr.SegmentationImage(levels, opacity=1.0))

    def frame(self, pixels: NDArray[np.uint8]) -> None:
        """Show a frame, grey [height, width] or RGB [height, width, 3]."""
        self._stream.log('frame', rr.Image(pixels))

    def contact(self, outline: NDArray[np.float64] | None) -> None:
        """Show the outline of the contact on the frame, columns and rows [n, 2]; None for none."""
        strips = [] if outline is None else [outline]
        self._stream.log('frame/contact', rr.LineStrips2D(strips, colors=[CONTACT], radii=[1.0]))

    def arrows(self, starts: NDArray[np.float64], vectors: NDArray[np.float64]) -> None:
        """Show a displacement on the frame: starts and vectors [n, 2] [px]."""
        arrows = rr.Arrows2D(origins=starts, vectors=vectors, colors=[FIELD], radii=[0.4])
        self._stream.log('frame/displacement', arrows)

    def text(self, entity: str, markdown: str) -> None:
        """Show a text."""
        self._stream.log(entity, rr.TextDocument(markdown, media_type='text/markdown'))

    def curve(self, entity: str, columns: tuple[NDArray[np.int64], NDArray[np.float64]]) -> None:
        """Append samples to a plotted line.

        Args:
            entity: One of `LINES`.
            columns: Times [ns, host clock] and values.
        """
        times, values = columns
        if not len(times):
            return
        index = rr.TimeColumn(TIMELINE, timestamp=times.view('datetime64[ns]'))
        self._stream.send_columns(entity, [index], rr.Scalars.columns(scalars=values))

    def show_slip(self) -> None:
        """Add the plot of the slip detection, once."""
        if not self._with_slip:
            self._with_slip = True
            self._stream.send_blueprint(layout(self._history_s, slip=True))

    def close(self) -> None:
        """Send remaining data and disconnect."""
        self._stream.flush(timeout_sec=2.0)
        self._stream.disconnect()
