# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The page of the live view in rerun, its server, and what is drawn once per picture.

The server runs as a separate process, because only rerun's program can be restricted to connections
from this machine. The same server inside a Python process listens on all interfaces.
"""

from __future__ import annotations

import importlib.util
import os
import socket
import subprocess
import tempfile
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from mixtac_core.events.codec import decode_message
from mixtac_core.events.errors import MixtacError
from mixtac_core.events.packets import CodecError, SequenceCounter
from mixtac_core.node.diagnostics import RateMeter
from mixtac_core.node.images import ImageConversionError, picture
from mixtac_core.node.process import GraphError, ProcessGroup

if TYPE_CHECKING:
    from mixtac_core.events.arrays import Events
    from mixtac_core.events.codec import PacketMessage


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


MOST_PACKETS: Final = 400
"""Event packets that wait for the next picture; the oldest of more are skipped."""
MOST_SAMPLES: Final = 4000
"""Samples of a plotted line that wait; the oldest of more are skipped."""
TEXT_PERIOD_NS: Final = 500_000_000
"""Time between two texts of the state [ns]."""
SILENT_NS: Final = 2_000_000_000
"""Time without an event packet after which the sensor is shown as ended [ns]."""
_OUTLINE = np.linspace(0.0, 2.0 * np.pi, 33)
_LEVELS = ('ok', '**warning**', '**ERROR**', 'stale')


def drained(queue: deque[Any]) -> list[Any]:
    """Return what waits in a queue, oldest first, and remove it; another thread may append."""
    return [queue.popleft() for _ in range(len(queue))]


@dataclass
class Received:
    """Filled by the subscriptions, emptied by the drawing thread.

    Attributes:
        packets: Event packets.
        counter: Packets received and lost.
        skipped: Packets not drawn because drawing was too slow.
        force: Arrival [ns] and estimated force [N].
        reference: Arrival [ns] and reference force [N].
        slip: Latest `mixtac_msgs/SlipState`, None before the first.
        contact: Latest `mixtac_msgs/Contact`, None before the first.
        frame: Latest `sensor_msgs/Image`, None once drawn.
        meters: Messages of each kind, for their rates.
        nodes: Level (0 ok, 1 warning, 2 error, 3 stale) and message of the nodes, by name.
    """

    packets: deque[PacketMessage] = field(default_factory=lambda: deque(maxlen=MOST_PACKETS))
    counter: SequenceCounter = field(default_factory=SequenceCounter)
    skipped: int = 0
    force: deque[tuple[int, float]] = field(default_factory=lambda: deque(maxlen=MOST_SAMPLES))
    reference: deque[tuple[int, float]] = field(default_factory=lambda: deque(maxlen=MOST_SAMPLES))
    slip: Any = None
    contact: Any = None
    frame: Any = None
    meters: dict[str, RateMeter] = field(
        default_factory=lambda: {
            name: RateMeter() for name in ('force', 'reference', 'packets', 'frames', 'events')
        }
    )
    nodes: dict[str, tuple[int, str]] = field(default_factory=dict)

    def on_packet(self, message: PacketMessage, seq: int) -> None:
        """Keep an event packet with its number."""
        self.counter.update(seq)
        self.skipped += len(self.packets) == MOST_PACKETS
        self.packets.append(message)
        self.meters['packets'].add(1)

    def on_frame(self, message: Any) -> None:  # noqa: ANN401
        """Keep a `sensor_msgs/Image`."""
        self.frame = message
        self.meters['frames'].add(1)

    def on_force(self, name: str, arrival_ns: int, force_n: float) -> None:
        """Keep a force, `force` or `reference`."""
        getattr(self, name).append((arrival_ns, force_n))
        self.meters[name].add(1)

    def on_diagnostics(self, message: Any) -> None:  # noqa: ANN401
        """Keep a `diagnostic_msgs/DiagnosticArray`."""
        for status in message.status:
            level = status.level[0] if isinstance(status.level, bytes) else int(status.level)
            # A new dictionary: the drawing thread iterates over the old one.
            self.nodes = {**self.nodes, status.name: (level, status.message)}


class EventPicture:
    """Adds up events per pixel, brighter minus darker, until the picture is taken.

    Args:
        height: Rows of the sensor.
        width: Columns of the sensor.

    Attributes:
        shape: Rows and columns.
    """

    def __init__(self, height: int, width: int) -> None:
        self.shape = (height, width)
        self._sum = np.zeros(height * width)

    def add(self, events: Events) -> None:
        """Count events; the decoder has checked their coordinates."""
        places = events.y.astype(np.intp) * self.shape[1] + events.x
        self._sum += np.bincount(places, 2.0 * events.polarity - 1.0, len(self._sum))

    def take(self) -> NDArray[np.uint8]:
        """Return the picture, one level per pixel [height, width], and start the next one."""
        levels = (np.clip(self._sum, -FULL, FULL) + STILL).astype(np.uint8)
        self._sum[:] = 0
        return levels.reshape(self.shape)


def contact_outline(message: Any) -> NDArray[np.float64]:  # noqa: ANN401
    """Return the ellipse of a `mixtac_msgs/Contact` in the image, columns and rows [33, 2]."""
    along, across = message.major * np.cos(_OUTLINE), message.minor * np.sin(_OUTLINE)
    cos, sin = np.cos(message.angle), np.sin(message.angle)
    x, y = cos * along - sin * across, sin * along + cos * across
    # Rows count downwards, y upwards.
    return np.stack([message.column + message.scale * x, message.row - message.scale * y], axis=1)


class Drawing:
    """Draws received messages.

    Args:
        received: Filled by the subscriptions.
        page: Where to draw.

    Attributes:
        undecodable: Packets and frames that could not be decoded.
    """

    def __init__(self, received: Received, page: Page) -> None:
        self.undecodable = 0
        self._received = received
        self._page = page
        self._picture = EventPicture(0, 0)
        self._latest = {'force': float('nan'), 'reference': float('nan')}
        self._next_text_ns = self._heard_ns = 0

    def draw(self, now_ns: int) -> None:
        """Draw everything received since the last call.

        Args:
            now_ns: Present time [ns, host clock].
        """
        received, page = self._received, self._page
        page.at(now_ns)
        self._draw_events(now_ns)
        self._draw_frame()
        if (contact := received.contact) is not None:
            page.contact(contact_outline(contact) if contact.located else None)
        for name, line in (('force', 'force/estimate'), ('reference', 'force/reference')):
            if samples := drained(getattr(received, name)):
                self._latest[name] = samples[-1][1]
                page.curve(line, samples)
        if now_ns >= self._next_text_ns:
            self._next_text_ns = now_ns + TEXT_PERIOD_NS
            ended = self._heard_ns > 0 and now_ns - self._heard_ns > SILENT_NS
            page.text(self._state(now_ns * 1e-9, ended=ended))

    def close(self, now_ns: int) -> None:
        """Show that the view has ended, and disconnect."""
        self._page.at(now_ns)
        self._page.text(self._state(now_ns * 1e-9, ended=True))
        self._page.close()

    def _draw_events(self, now_ns: int) -> None:
        if messages := drained(self._received.packets):
            self._heard_ns = now_ns
        for message in messages:
            try:
                events = decode_message(message).events
            except CodecError:
                self.undecodable += 1
                continue
            size = (int(message.height), int(message.width))
            if self._picture.shape != size:
                self._picture = EventPicture(*size)
            self._picture.add(events)
            self._received.meters['events'].add(len(events))
        if messages and all(self._picture.shape):
            self._page.events(self._picture.take())

    def _draw_frame(self) -> None:
        message, self._received.frame = self._received.frame, None
        if message is None:
            return
        try:
            image = picture(message)
        except ImageConversionError:
            self.undecodable += 1
            return
        self._page.frame(image)

    def _state(self, now_s: float, *, ended: bool) -> str:
        received, force_n = self._received, self._latest['force']
        title = 'ended' if ended else 'no force yet' if np.isnan(force_n) else f'{force_n:.2f} N'
        rates = {name: meter.read(now_s) for name, meter in received.meters.items()}
        gaps = f'{received.counter.lost} lost, {received.skipped} not drawn'
        slip = 'not running'
        if received.slip is not None:
            slip = '**SLIP**' if received.slip.slipping else 'stable'
            slip += f', {received.slip.count:g} events of {received.slip.threshold:g}'
        rows = [
            f'force | {rates["force"]:.0f} Hz',
            f'reference | {self._latest["reference"]:.2f} N at {rates["reference"]:.0f} Hz',
            f'slip | {slip}',
            f'events | {rates["events"] / 1000:.1f} k/s',
            f'packets | {rates["packets"]:.0f} /s; {gaps}',
            f'frames | {rates["frames"]:.1f} /s',
        ]
        nodes = [
            f'{name} | {_LEVELS[min(level, 3)]}: {message.replace("|", "/")}'
            for name, (level, message) in sorted(received.nodes.items())
        ]
        table = '\n'.join(f'| {row} |' for row in rows + nodes)
        return f'# {title}\n\n| | |\n|---|---|\n{table}'
