# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the live view has received, in bounded memory, and how it is drawn once per picture.

The events of a picture are an image by polarity. Of each plotted line the extreme samples stay.
"""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mixtac_events.codec import decode_message
from mixtac_events.packets import CodecError
from mixtac_events.sequence import SequenceCounter
from mixtac_node.diagnostics import RateMeter
from mixtac_node.images import ImageConversionError, image_array

if TYPE_CHECKING:
    from mixtac_cli.view.page import Page
    from mixtac_events.arrays import Events
    from mixtac_events.codec import PacketMessage


Columns = tuple[NDArray[np.int64], NDArray[np.float64]]


class Curve:
    """Keeps the samples of one plotted line until they are taken.

    One thread adds, another takes.

    Args:
        capacity: Samples that are kept until they are taken; further ones are dropped.

    Attributes:
        received: Samples so far.
        dropped: Samples dropped because the buffer was full.
        latest: The last value, NaN before the first.
    """

    def __init__(self, capacity: int = 4000) -> None:
        self.received = 0
        self.dropped = 0
        self.latest = float('nan')
        self._time_ns = np.zeros(capacity, np.int64)
        self._value = np.zeros(capacity)
        self._count = 0
        self._lock = threading.Lock()

    def add(self, time_ns: int, value: float) -> None:
        """Keep a sample.

        Args:
            time_ns: Time in the plot [ns].
            value: Plotted value.
        """
        self.received += 1
        self.latest = value
        with self._lock:
            i = self._count
            if i == len(self._value):
                self.dropped += 1
                return
            self._time_ns[i] = time_ns
            self._value[i] = value
            self._count = i + 1

    def take(self, limit: int) -> Columns:
        """Return times [ns] and values since the last call, at most `limit` of them.

        Of each group of neighbours the one farthest from their mean stays, so that a peak is never
        thinned away.
        """
        with self._lock:
            n = self._count
            times, values = self._time_ns[:n].copy(), self._value[:n].copy()
            self._count = 0
        return thinned(times, values, limit)


def thinned(times: NDArray[np.int64], values: NDArray[np.float64], limit: int) -> Columns:
    """Return at most `limit` of the samples, keeping the extreme one of each group.

    Args:
        times: Times [ns].
        values: Values at these.
        limit: Largest number of samples to return, at least 1.
    """
    n = len(values)
    if n <= limit:
        return times, values
    starts = np.linspace(0, n, limit + 1).astype(np.intp)[:-1]
    lengths = np.diff(np.append(starts, n))
    means = np.add.reduceat(values, starts) / lengths
    distance = np.abs(values - np.repeat(means, lengths))
    # Stable order by group, then by distance: the last of each group is its farthest.
    group = np.repeat(np.arange(limit), lengths)
    kept = np.lexsort((distance, group))[np.append(starts[1:], n) - 1]
    return times[kept], values[kept]


MOST_PACKETS = 400
MOST_BYTES = 2_000_000


class PacketBacklog:
    """Keeps event packets until they are drawn.

    Attributes:
        counter: Packets received and lost.
        skipped: Packets not drawn because drawing was too slow.
    """

    def __init__(self) -> None:
        self.counter = SequenceCounter()
        self.skipped = 0
        self._waiting: deque[PacketMessage] = deque()
        self._bytes = 0
        self._lock = threading.Lock()

    def add(self, message: PacketMessage, seq: int) -> None:
        """Keep a packet; the oldest ones are skipped when there are too many.

        Args:
            message: The packet.
            seq: Its number.
        """
        self.counter.update(seq)
        with self._lock:
            self._waiting.append(message)
            self._bytes += len(message.events)
            while len(self._waiting) > MOST_PACKETS or self._bytes > MOST_BYTES:
                self._bytes -= len(self._waiting.popleft().events)
                self.skipped += 1

    def take(self) -> list[PacketMessage]:
        """Return the waiting packets, oldest first, and forget them."""
        with self._lock:
            taken = list(self._waiting)
            self._waiting.clear()
            self._bytes = 0
        return taken


@dataclass
class Received:
    """Filled by the subscriptions, emptied by the drawing thread.

    Attributes:
        packets: Event packets.
        force: Estimated force [N] over arrival.
        reference: Reference force [N] over arrival.
        slip_count: Events per counting window over arrival.
        slip_threshold: The count above which the object slips.
        slipping: Latest result of the slip detection, None before the first.
        contact: Latest contact, None before the first.
        displacement: Latest displacement of the beads, None once drawn.
        frame: Latest frame, None once drawn.
        frames: Frames received.
        nodes: Level (0 ok, 1 warning, 2 error, 3 stale) and message of the nodes, by name.
    """

    packets: PacketBacklog = field(default_factory=PacketBacklog)
    force: Curve = field(default_factory=Curve)
    reference: Curve = field(default_factory=Curve)
    slip_count: Curve = field(default_factory=Curve)
    slip_threshold: Curve = field(default_factory=Curve)
    slipping: bool | None = None
    contact: Any = None
    displacement: Any = None
    frame: Any = None
    frames: int = 0
    nodes: dict[str, tuple[int, str]] = field(default_factory=dict)

    def on_frame(self, message: Any) -> None:  # noqa: ANN401
        """Keep a `sensor_msgs/Image`."""
        self.frame = message
        self.frames += 1

    def on_slip(self, message: Any, arrival_ns: int) -> None:  # noqa: ANN401
        """Keep a `mixtac_msgs/SlipState`."""
        self.slip_count.add(arrival_ns, float(message.count))
        self.slip_threshold.add(arrival_ns, float(message.threshold))
        self.slipping = bool(message.slipping)

    def on_contact(self, message: Any) -> None:  # noqa: ANN401
        """Keep a `mixtac_msgs/Contact`."""
        self.contact = message

    def on_field(self, message: Any) -> None:  # noqa: ANN401
        """Keep the displacement of the beads, a `sensor_msgs/Image` 32FC2."""
        self.displacement = message

    def on_diagnostics(self, message: Any) -> None:  # noqa: ANN401
        """Keep a `diagnostic_msgs/DiagnosticArray`."""
        for status in message.status:
            level = status.level[0] if isinstance(status.level, bytes) else int(status.level)
            # A new dictionary: the drawing thread iterates over the old one.
            self.nodes = {**self.nodes, status.name: (level, status.message)}


Colour = tuple[int, int, int]
BACKGROUND = (24, 26, 30)
BRIGHTER = (86, 180, 233)
"""Like `DARKER` from the palette of Okabe and Ito, which colour-blind people can distinguish."""
DARKER = (230, 120, 20)
FULL = 3
"""Surplus of events of one polarity at which a pixel has its full colour."""
STILL = FULL + 1
"""Level of a pixel without events, or with as many of both polarities. 0 is not used."""


class EventPicture:
    """Adds up events per pixel, brighter minus darker, until the picture is taken.

    Args:
        width: Columns of the sensor.
        height: Rows of the sensor.

    Attributes:
        shape: Rows and columns.
    """

    def __init__(self, width: int, height: int) -> None:
        self.shape = (height, width)
        self._sum = np.zeros(height * width, np.int64)

    def add(self, events: Events) -> None:
        """Count events; the decoder has checked their coordinates."""
        height, width = self.shape
        places = events.y.astype(np.intp) * width + events.x
        counts = np.bincount(places, weights=2.0 * events.polarity - 1.0, minlength=height * width)
        self._sum += counts.astype(np.int64)

    def take(self) -> NDArray[np.uint8]:
        """Return the picture, one level per pixel [height, width], and start the next one."""
        levels = (np.clip(self._sum, -FULL, FULL) + STILL).astype(np.uint8)
        self._sum[:] = 0
        return levels.reshape(self.shape)


def palette() -> dict[int, Colour]:
    """Return the colour of each level."""
    colours = {STILL: BACKGROUND}
    for step in range(1, FULL + 1):
        shade = 0.35 + 0.65 * (step - 1) / (FULL - 1)
        colours[STILL + step] = _mixed(BRIGHTER, shade)
        colours[STILL - step] = _mixed(DARKER, shade)
    return colours


def _mixed(colour: Colour, shade: float) -> Colour:
    red, green, blue = (
        round(shade * full + (1.0 - shade) * none)
        for full, none in zip(colour, BACKGROUND, strict=True)
    )
    return red, green, blue


FIELD_PX = 8
"""Distance of the points of a displacement in the camera's image [px]."""
EXAGGERATION = 10.0
"""Factor by which arrows are longer than the displacement."""
OUTLINE = np.linspace(0.0, 2.0 * np.pi, 33)


def contact_outline(message: Any) -> NDArray[np.float64]:  # noqa: ANN401
    """Return the ellipse of a `mixtac_msgs/Contact` in the image, columns and rows [33, 2]."""
    along, across = message.major * np.cos(OUTLINE), message.minor * np.sin(OUTLINE)
    cos, sin = np.cos(message.angle), np.sin(message.angle)
    x, y = cos * along - sin * across, sin * along + cos * across
    # Rows count downwards, y upwards.
    return np.stack([message.column + message.scale * x, message.row - message.scale * y], axis=1)


def field_arrows(message: Any, scale: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:  # noqa: ANN401
    """Return starts and vectors of the arrows of a displacement in the image [n, 2] [px].

    Args:
        message: A `sensor_msgs/Image` 32FC2 [m].
        scale: Of the camera's image [px/m].
    """
    shape = (message.height, message.width, 2)
    moved = np.frombuffer(message.data, np.float32).reshape(shape)[::2, ::2]
    rows, columns = np.mgrid[0 : shape[0] : 2, 0 : shape[1] : 2]
    starts = FIELD_PX * (np.stack([columns, rows], axis=-1) + 0.5) - 0.5
    vectors = EXAGGERATION * scale * moved * np.array([1.0, -1.0])
    return starts.reshape(-1, 2), vectors.reshape(-1, 2)


MOST_SAMPLES = 25
"""Samples per line and picture: 500 a second at 20 pictures."""
_TEXT_PERIOD_NS = 500_000_000
_LEVELS = ('ok', '**warning**', '**ERROR**', 'stale')


class Drawing:
    """Draws received messages.

    Args:
        received: Filled by the subscriptions.
        canvas: The page to draw on.

    Attributes:
        undecodable: Packets and frames that could not be decoded.
    """

    def __init__(self, received: Received, canvas: Page) -> None:
        self.undecodable = 0
        self._received = received
        self._canvas = canvas
        self._picture: EventPicture | None = None
        self._events = 0
        self._meters = {
            name: RateMeter() for name in ('events', 'packets', 'frames', 'force', 'reference')
        }
        self._rates: dict[str, float] = {}
        self._next_text_ns = 0

    def draw(self, now_ns: int) -> None:
        """Draw everything received since the last call.

        Args:
            now_ns: Present time [ns, host clock].
        """
        received, canvas = self._received, self._canvas
        canvas.at(now_ns)
        self._draw_events()
        self._draw_frame()
        self._draw_contact()
        canvas.curve('force/estimate', received.force.take(MOST_SAMPLES))
        canvas.curve('force/reference', received.reference.take(MOST_SAMPLES))
        if received.slipping is not None:
            canvas.show_slip()
            canvas.curve('slip/count', received.slip_count.take(MOST_SAMPLES))
            canvas.curve('slip/threshold', received.slip_threshold.take(MOST_SAMPLES))
        if now_ns >= self._next_text_ns:
            self._next_text_ns = now_ns + _TEXT_PERIOD_NS
            self._draw_rates(now_ns)
            canvas.text('state', self._state())

    def _draw_events(self) -> None:
        messages = self._received.packets.take()
        for message in messages:
            try:
                events = decode_message(message).events
            except CodecError:
                self.undecodable += 1
                continue
            size = (int(message.height), int(message.width))
            if self._picture is None or self._picture.shape != size:
                self._picture = EventPicture(size[1], size[0])
            self._picture.add(events)
            self._events += len(events)
        if messages and self._picture is not None:
            self._canvas.events(self._picture.take())

    def _draw_frame(self) -> None:
        message, self._received.frame = self._received.frame, None
        if message is None:
            return
        mono = str(message.encoding).startswith(('mono', '8UC1', '16UC1'))
        try:
            image = image_array(message, 'mono8' if mono else 'rgb8')
        except ImageConversionError:
            self.undecodable += 1
            return
        self._canvas.frame(np.asarray(image, np.uint8))

    def _draw_contact(self) -> None:
        contact = self._received.contact
        if contact is None:
            return
        outline = contact_outline(contact) if contact.located else None
        self._canvas.contact(outline)
        field, self._received.displacement = self._received.displacement, None
        if field is not None and contact.scale > 0.0:
            self._canvas.arrows(*field_arrows(field, contact.scale))

    def _draw_rates(self, now_ns: int) -> None:
        received = self._received
        totals = {
            'events': self._events,
            'packets': received.packets.counter.received,
            'frames': received.frames,
            'force': received.force.received,
            'reference': received.reference.received,
        }
        for name, total in totals.items():
            meter = self._meters[name]
            meter.add(total - meter.total)
            rate = meter.read(now_ns * 1e-9)
            self._rates[name] = rate
            shown = rate / 1000 if name == 'events' else rate
            self._canvas.curve(
                f'rates/{name}', (np.array([now_ns], np.int64), np.array([shown], np.float64))
            )

    def _state(self) -> str:
        received, rates = self._received, self._rates
        slip = {None: 'not running', False: 'stable', True: '**SLIP**'}[received.slipping]
        gaps = f'{received.packets.counter.lost} lost, {received.packets.skipped} not drawn'
        lines = [
            '| | |',
            '|---|---|',
            f'| force | **{_newtons(received.force.latest)}** at {rates["force"]:.0f} Hz |',
            f'| reference | {_newtons(received.reference.latest)} at {rates["reference"]:.0f} Hz |',
            f'| contact | {_place(received.contact)} |',
            f'| slip | {slip} |',
            f'| events | {rates["events"] / 1000:.1f} k/s |',
            f'| packets | {rates["packets"]:.0f} /s; {gaps} |',
            f'| frames | {rates["frames"]:.1f} /s |',
            f'| undecodable | {self.undecodable} |',
            '',
            '| node | | message |',
            '|---|---|---|',
        ]
        for name, (level, message) in sorted(received.nodes.items()):
            shown = message.replace('|', '/')
            lines.append(f'| {name} | {_LEVELS[min(level, 3)]} | {shown} |')
        return '\n'.join(lines)


def _place(contact: Any) -> str:  # noqa: ANN401
    """Return a contact in words; lengths in millimetres."""
    if contact is None or not contact.in_contact:
        return 'none'
    if not contact.located:
        return 'somewhere'
    x, y, area = 1e3 * contact.position.x, 1e3 * contact.position.y, 1e6 * contact.area
    return f'x {x:+.1f}, y {y:+.1f} mm, {area:.0f} mm^2'


def _newtons(value: float) -> str:
    return 'none yet' if np.isnan(value) else f'{value:.2f} N'
