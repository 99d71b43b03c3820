# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The page of the live view in rerun, and rerun's own server for it.

The server is a process, because only rerun's program can be bound to this machine: the same server
within a Python process listens on all interfaces.
"""

from __future__ import annotations

import importlib.util
import os
import socket
import subprocess
import tempfile
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from mixtac_core.events.errors import MixtacError
from mixtac_core.node.process import GraphError, ProcessGroup


class ViewError(MixtacError):
    """A live view that cannot be served or written."""


HOST: Final = '127.0.0.1'
TIMELINE: Final = 'received'
"""Arrival at the view on the host clock, which all topics have in common."""
LINES = {
    'force/estimate': ('estimate', (0, 158, 115)),
    'force/reference': ('reference', (230, 159, 0)),
}
"""Name in the legend and colour of each plotted line, by its path."""
FULL: Final = 3
"""Surplus of events of one polarity at which a pixel has its full colour."""
STILL: Final = FULL + 1
"""Level of a pixel without events, or with as many of both polarities. 0 is not used."""
COLOURS = {
    1: (230, 120, 20), 2: (189, 101, 22), 3: (148, 82, 24),
    STILL: (24, 26, 30),
    5: (61, 118, 152), 6: (74, 149, 192), 7: (86, 180, 233),
}  # fmt: skip
"""Colour of each level: darker orange, brighter blue, which colour-blind people can distinguish."""
CONTACT_COLOUR: Final = (240, 228, 66)


def require_rerun() -> Path:
    """Return the path of rerun's program.

    Raises:
        ViewError: The optional package rerun-sdk is not installed.
    """
    spec = importlib.util.find_spec('rerun_cli')
    if spec is None or spec.origin is None:
        raise ViewError(
            'the live view needs rerun-sdk (about 500 MB)', remedy='install it with `make view`'
        )
    # The script of that name would start this program as a child and not end it.
    return Path(spec.origin).parent / 'rerun'


class ViewerServer:
    """rerun's server for the page and its data, on this machine only and without telemetry.

    Args:
        port: Port of the page; 0 for any free one.
        data_port: Port of its data; 0 for any free one.
        memory_mb: Data kept for pages opened later [MB].

    Attributes:
        data_url: Address to send the data to.
        page_url: Address to open in a browser.

    Raises:
        ViewError: rerun-sdk is missing, or a port is in use.
    """

    def __init__(self, port: int, data_port: int, memory_mb: int) -> None:
        program = require_rerun()
        port, data_port = free_port(port, 'port'), free_port(data_port, 'data_port')
        self.data_url = f'rerun+http://{HOST}:{data_port}/proxy'
        self.page_url = f'http://{HOST}:{port}/?url={quote(self.data_url, safe="")}'
        self._home = tempfile.TemporaryDirectory(prefix='mixtac-view-')
        # rerun's settings are private, so that the user's own stay as they are.
        folders = {f'XDG_{each}_HOME': f'{self._home.name}/{each}' for each in ('CONFIG', 'DATA')}
        environment = {**os.environ, **folders, 'TELEMETRY_ENABLED': 'false'}
        subprocess.run(
            [program, 'analytics', 'disable'], env=environment, capture_output=True, check=False
        )
        self._processes = ProcessGroup(Path(self._home.name), environment)
        command = [str(program), '--serve-web', '--bind', HOST, '--port', str(data_port)]
        command += ['--web-viewer-port', str(port), '--server-memory-limit', f'{memory_mb}MB']
        self._processes.start('server', command)

    def check(self) -> None:
        """Raise a ViewError if the server has ended by itself."""
        try:
            self._processes.check()
        except GraphError as error:
            lines = Path(self._home.name, 'server.log').read_text(errors='replace').split('\n')
            last = next(filter(None, reversed(lines)), 'no output')
            raise ViewError(f'live view: {error}; {last}') from error

    def close(self) -> None:
        """End the server and remove its files."""
        self._processes.stop()
        self._home.cleanup()


def free_port(port: int, name: str) -> int:
    """Return a free TCP port of this machine.

    Args:
        port: Wanted port, 0 for any.
        name: Name of its parameter.

    Raises:
        ViewError: It is in use.
    """
    with socket.socket() as trial:
        trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            trial.bind((HOST, port))
        except OSError as error:
            raise ViewError(
                f'{name} {port} cannot be used ({error.strerror})',
                remedy='stop the other view, or choose another port or 0 for any',
            ) from error
        return int(trial.getsockname()[1])


class Page:
    """A stream of drawings to the server, or to a file.

    Args:
        history_s: Width of the plots [s].
        url: Address at which the server receives data.
        path: New .rrd file to write instead of sending.
    """

    def __init__(self, history_s: float, url: str = '', path: Path | None = None) -> None:
        import rerun as rr

        self._rr, self._stream = rr, rr.RecordingStream('mixtac')
        if path is not None:
            self._stream.save(path, default_blueprint=layout(history_s))
        else:
            self._stream.connect_grpc(url, default_blueprint=layout(history_s))
        classes = [rr.AnnotationInfo(level, color=each) for level, each in COLOURS.items()]
        self._stream.log('events', rr.AnnotationContext(classes), static=True)
        for entity, (name, colour) in LINES.items():
            line = rr.SeriesLines(colors=[colour], names=[name], widths=[1.5])
            self._stream.log(entity, line, static=True)

    def at(self, time_ns: int) -> None:
        """Set the time of the next pictures and texts [ns, host clock]."""
        self._stream.set_time(TIMELINE, timestamp=time_ns * 1e-9)

    def events(self, levels: NDArray[np.uint8]) -> None:
        """Show a picture of events, levels of `EventPicture` [height, width]."""
        # Not compressed: browsers decompress slowly and show nothing until then.
        self._stream.log('events', self._rr.SegmentationImage(levels, opacity=1.0))

    def frame(self, pixels: NDArray[np.uint8]) -> None:
        """Show a frame, grey [height, width] or RGB [height, width, 3]."""
        self._stream.log('frame', self._rr.Image(pixels))

    def contact(self, outline: NDArray[np.float64] | None) -> None:
        """Show the outline of the contact on the frame, columns and rows [n, 2]; None for none."""
        strips = [] if outline is None else [outline]
        lines = self._rr.LineStrips2D(strips, colors=[CONTACT_COLOUR], radii=[1.0])
        self._stream.log('frame/contact', lines)

    def text(self, markdown: str) -> None:
        """Show the state of the sensor."""
        self._stream.log('state', self._rr.TextDocument(markdown, media_type='text/markdown'))

    def curve(self, entity: str, samples: list[tuple[int, float]]) -> None:
        """Append samples to a plotted line.

        Args:
            entity: One of `LINES`.
            samples: Times [ns, host clock] and values.
        """
        if samples:
            times, values = zip(*samples, strict=True)
            stamps = np.array(times, 'datetime64[ns]')
            index = self._rr.TimeColumn(TIMELINE, timestamp=stamps)
            columns = self._rr.Scalars.columns(scalars=np.array(values))
            self._stream.send_columns(entity, [index], columns)

    def close(self) -> None:
        """Send remaining data and disconnect."""
        self._stream.flush(timeout_sec=2.0)
        self._stream.disconnect()


def layout(history_s: float) -> Any:  # noqa: ANN401
    """Return the blueprint: events above frame, the force in the middle, the state at the right.

    Args:
        history_s: Width of the plot [s].
    """
    import rerun.blueprint as rrb

    boundary = rrb.TimeRangeBoundary
    shown = rrb.VisibleTimeRange(
        TIMELINE,
        start=boundary.cursor_relative(seconds=-history_s),
        end=boundary.cursor_relative(),
    )
    force = rrb.TimeSeriesView(
        origin='force',
        name='Normal force [N]',
        plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.LeftTop),
        time_ranges=shown,
    )
    pictures = rrb.Vertical(
        rrb.Spatial2DView(origin='events', name='Events: blue brighter, orange darker'),
        rrb.Spatial2DView(origin='frame', name='APS frame'),
    )
    state = rrb.TextDocumentView(origin='state', name='State')
    return rrb.Blueprint(
        rrb.Horizontal(pictures, force, state, column_shares=[3, 5, 3]),
        rrb.TimePanel(state='collapsed', timeline=TIMELINE, play_state='following'),
        collapse_panels=True,
        auto_views=False,
    )
