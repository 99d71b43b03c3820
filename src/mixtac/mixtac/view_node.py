# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The live view node: subscribes, and draws with rerun.

The server of the page runs as a separate process, because only rerun's program can be restricted to
connections from this machine. The same server inside a Python process listens on all interfaces.
"""

from __future__ import annotations

import importlib.util
import os
import socket
import subprocess
import tempfile
import time
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from mixtac.parameters import ViewParameters
from mixtac_core.events.codec import decode_message, warm_up
from mixtac_core.events.errors import MixtacError
from mixtac_core.events.packets import CodecError, SequenceCounter
from mixtac_core.node import topics
from mixtac_core.node.base_node import BaseNode, declare, run
from mixtac_core.node.diagnostics import OK, WARN, DiagnosticsPublisher, RateMeter, Status
from mixtac_core.node.files import writable
from mixtac_core.node.images import ImageConversionError, picture
from mixtac_core.node.process import ProcessGroup

if TYPE_CHECKING:
    from mixtac_core.events.arrays import Events


class ViewError(MixtacError):
    """A live view that cannot be served or written."""


HOST: Final = '127.0.0.1'
TIMELINE: Final = 'received'
"""Arrival at the view on the host clock, which all topics have in common."""
LINES: Final = {'estimate': (0, 158, 115), 'reference': (230, 159, 0)}
"""Colour of each plotted force."""
FULL: Final = 3
"""Surplus of events of one polarity at which a pixel has its full colour."""
STILL: Final = FULL + 1
"""Level of a pixel without events, or with as many of both polarities. 0 is not used."""
COLOURS: Final = {
    1: (255, 170, 70), 2: (245, 140, 35), 3: (215, 110, 20),
    STILL: (24, 26, 30),
    5: (70, 150, 205), 6: (90, 185, 240), 7: (150, 220, 255),
}  # fmt: skip
"""Colour of each level: darker orange, brighter blue, which colour-blind people can distinguish."""
CONTACT_COLOUR: Final = (240, 228, 66)
FLOOR_N: Final = 0.1
"""Force that the plot always includes [N]: noise alone does not fill it."""
TEXT_PERIOD_S: Final = 0.5
"""Time between two texts of the state [s]."""
_OUTLINE: Final = np.linspace(0.0, 2.0 * np.pi, 33)
_LEVELS: Final = ('ok', '**warning**', '**ERROR**', 'stale')


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
        processes: The server.

    Raises:
        ViewError: rerun-sdk is missing, or a port is in use.
    """

    def __init__(self, port: int, data_port: int, memory_mb: int) -> None:
        program = require_rerun()
        port, data_port = free_port(port, 'port'), free_port(data_port, 'data_port')
        self.data_url = f'rerun+http://{HOST}:{data_port}/proxy'
        self.page_url = f'http://{HOST}:{port}/?url={quote(self.data_url, safe="")}&theme=dark'
        self._home = tempfile.TemporaryDirectory(prefix='mixtac-view-')
        # rerun's settings are private, so that the user's own stay as they are.
        folders = {f'XDG_{each}_HOME': f'{self._home.name}/{each}' for each in ('CONFIG', 'DATA')}
        environment = {**os.environ, **folders, 'TELEMETRY_ENABLED': 'false'}
        subprocess.run(
            [program, 'analytics', 'disable'], env=environment, capture_output=True, check=False
        )
        self.processes = ProcessGroup(Path(self._home.name), environment)
        command = [str(program), '--serve-web', '--bind', HOST, '--port', str(data_port)]
        command += ['--web-viewer-port', str(port), '--server-memory-limit', f'{memory_mb}MB']
        self.processes.start('server of the live view', command)

    def close(self) -> None:
        """End the server and remove its files."""
        self.processes.stop()
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


def layout(history_s: float) -> Any:  # noqa: ANN401
    """Return the blueprint: events above frame, the force in the middle, the state at the right.

    Args:
        history_s: Width of the plot [s].
    """
    import rerun.blueprint as rrb

    ago = rrb.TimeRangeBoundary.cursor_relative
    shown = rrb.VisibleTimeRange(TIMELINE, start=ago(seconds=-history_s), end=ago())
    pictures = rrb.Vertical(
        rrb.Spatial2DView(origin='events', name='Events: blue brighter, orange darker'),
        rrb.Spatial2DView(origin='frame', name='APS frame'),
    )
    return rrb.Blueprint(
        rrb.Horizontal(
            pictures,
            rrb.TimeSeriesView(origin='force', name='Normal force [N]', time_ranges=shown),
            rrb.TextDocumentView(origin='state', name='State'),
            column_shares=[3, 5, 3],
        ),
        rrb.TimePanel(state='collapsed', timeline=TIMELINE, play_state='following'),
        collapse_panels=True,
        auto_views=False,
    )


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


def newton(force_n: float) -> str:
    """Return a force as text; one that rounds to zero has no sign."""
    return 'no force' if np.isnan(force_n) else f'{round(force_n, 2) + 0.0:.2f} N'


class ViewNode(BaseNode, Node):  # type: ignore[misc]
    """Only subscribes, best effort: no publisher waits for it, and packets that it misses count."""

    def __init__(self) -> None:
        super().__init__('view')
        self._settings = p = declare(self, ViewParameters)
        self._server: ViewerServer | None = None
        self._counter, self._undecodable = SequenceCounter(), 0
        self._meters = {n: RateMeter() for n in ('estimate', 'reference', 'events', 'frames')}
        self._picture = EventPicture(0, 0)
        self._force: dict[str, list[tuple[int, float]]] = {name: [] for name in LINES}
        self._latest_n = dict.fromkeys(LINES, float('nan'))
        self._frame: Any = None
        self._contact: Any = None
        self._nodes: dict[str, str] = {}
        self._text_s = 0.0
        self._open_page()
        self._diagnostics = DiagnosticsPublisher(self, 'view', self._status)
        with self._diagnostics.compiling('the packet codec'):
            warm_up()
        self.subscribe_topic(topics.EVENTS, self._on_events)
        self.subscribe_topic(topics.IMAGE_RAW, self._on_frame)
        self.subscribe_topic(topics.CONTACT, partial(setattr, self, '_contact'))
        self.subscribe_topic(topics.DIAGNOSTICS, self._on_diagnostics)
        self.subscribe_topic(topics.FORCE, partial(self._on_force, 'estimate'))
        measured = partial(self._on_force, 'reference')
        self.subscribe_topic(topics.REFERENCE_WRENCH, measured, name=p.reference_topic)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(1.0 / p.rate, self._draw, clock=steady)

    def check(self) -> None:
        """Raise a GraphError if the server has ended by itself."""
        if self._server is not None:
            self._server.processes.check()

    def close(self) -> None:
        """Send remaining data and that the view has ended, then end the server."""
        end = self._rr.TextDocument('# The view has ended', media_type='text/markdown')
        self._stream.log('state', end)
        with suppress(RuntimeError):  # It is not sent in time: the machine is busy.
            self._stream.flush(timeout_sec=2.0)
        self._stream.disconnect()
        if self._server is not None:
            self._server.close()

    def _open_page(self) -> None:
        require_rerun()
        import rerun as rr

        p = self._settings
        self._rr, self._stream = rr, rr.RecordingStream('mixtac')
        if p.save:
            path = Path(p.save)
            if path.exists():
                raise ViewError(f'{path} exists', remedy='name a new file in `save`')
            writable(path)
            path.parent.mkdir(parents=True, exist_ok=True)
            self._stream.save(path, default_blueprint=layout(p.history))
            self.get_logger().info(f'writing {path}')
        else:
            self._server = ViewerServer(p.port, p.data_port, p.memory)
            self._stream.connect_grpc(self._server.data_url, default_blueprint=layout(p.history))
            self.get_logger().info(f'live view: {self._server.page_url}')
        classes = [rr.AnnotationInfo(level, color=each) for level, each in COLOURS.items()]
        self._stream.log('events', rr.AnnotationContext(classes), static=True)
        for name, colour in LINES.items():
            line = rr.SeriesLines(colors=[colour], names=[name], widths=[1.5])
            self._stream.log(f'force/{name}', line, static=True)
        # Invisible, on a light page too.
        floor = rr.SeriesLines(colors=[(0, 0, 0, 0)] * 2, names=['', ''], widths=[0.5, 0.5])
        self._stream.log('force/floor', floor, static=True)

    def _on_events(self, message: Any) -> None:  # noqa: ANN401
        self._counter.update(message.seq)
        try:
            events = decode_message(message).events
        except CodecError:
            self._undecodable += 1
            return
        size = (int(message.height), int(message.width))
        if self._picture.shape != size:
            self._picture = EventPicture(*size)
        self._picture.add(events)
        self._meters['events'].add(len(events))

    def _on_frame(self, message: Any) -> None:  # noqa: ANN401
        self._frame = message
        self._meters['frames'].add(1)

    def _on_force(self, name: str, message: topics.ForceMessage) -> None:
        self._latest_n[name] = topics.normal_force(message)
        self._force[name].append((time.time_ns(), self._latest_n[name]))
        self._meters[name].add(1)

    def _on_diagnostics(self, message: Any) -> None:  # noqa: ANN401
        for status in message.status:
            level = _LEVELS[min(status.level[0], 3)]
            self._nodes[status.name] = f'{level}, {status.message}'

    def _draw(self) -> None:
        """Draw everything received since the last call.

        Raises:
            ViewError: It cannot be drawn, or not be written to the file.
        """
        try:
            self._log_all()
        except Exception as error:
            raise ViewError(f'the live view stopped: {error}') from error

    def _log_all(self) -> None:
        rr, log = self._rr, self._stream.log
        self._stream.set_time(TIMELINE, timestamp=time.time())
        if all(self._picture.shape):
            # Not compressed: browsers decompress slowly and show nothing until then.
            log('events', rr.SegmentationImage(self._picture.take(), opacity=1.0))
        frame, self._frame = self._frame, None
        if frame is not None:
            try:
                log('frame', rr.Image(picture(frame)))
            except ImageConversionError:
                self._undecodable += 1
        if (contact := self._contact) is not None:
            strips = [contact_outline(contact)] if contact.located else []
            log('frame/contact', rr.LineStrips2D(strips, colors=[CONTACT_COLOUR], radii=[1.0]))
        log('force/floor', rr.Scalars([-FLOOR_N, FLOOR_N]))
        for name, samples in self._force.items():
            if samples:
                times, values = zip(*samples, strict=True)
                index = rr.TimeColumn(TIMELINE, timestamp=np.array(times, 'datetime64[ns]'))
                columns = rr.Scalars.columns(scalars=np.array(values))
                self._stream.send_columns(f'force/{name}', [index], columns)
                samples.clear()
        if (now_s := time.monotonic()) > self._text_s + TEXT_PERIOD_S:
            self._text_s = now_s
            log('state', rr.TextDocument(self._state(now_s), media_type='text/markdown'))

    def _state(self, now_s: float) -> str:
        rates = {name: meter.read(now_s) for name, meter in self._meters.items()}
        rows = {
            **{n: f'{newton(self._latest_n[n])} at {rates[n]:.0f} Hz' for n in LINES},
            'events': f'{rates["events"] / 1000:.1f} k/s, {self._counter.lost} packets lost',
            'frames': f'{rates["frames"]:.1f} /s',
        }
        table = '\n'.join(f'| {name} | {text} |' for name, text in rows.items())
        # As paragraphs, which are wrapped; rows of a table are cut off.
        nodes = '\n\n'.join(f'{name}: {text}' for name, text in sorted(self._nodes.items()))
        force = newton(self._latest_n['estimate'])
        return f'# {force}\n\n| | |\n|---|---|\n{table}\n\n{nodes}'

    def _status(self) -> Status:
        bad = self._undecodable
        values: dict[str, object] = {
            'packets lost': self._counter.lost,
            'undecodable': bad,
            'page': self._server.page_url if self._server else self._settings.save,
        }
        return Status(WARN if bad else OK, f'{bad} undecodable' if bad else 'showing', values)


main = partial(run, ViewNode)
