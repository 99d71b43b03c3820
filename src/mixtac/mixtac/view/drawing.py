# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the live view has received, in bounded memory, and how it is drawn once per picture."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from mixtac.view.page import FULL, STILL, Page
from mixtac_core.events.codec import decode_message
from mixtac_core.events.packets import CodecError
from mixtac_core.events.sequence import SequenceCounter
from mixtac_core.node.diagnostics import RateMeter
from mixtac_core.node.images import ImageConversionError, picture

if TYPE_CHECKING:
    from mixtac_core.events.arrays import Events
    from mixtac_core.events.codec import PacketMessage

MOST_PACKETS: Final = 400
"""Event packets that wait for the next picture; the oldest of more are skipped."""
MOST_SAMPLES: Final = 4000
"""Samples of a plotted line that wait; the oldest of more are skipped."""
TEXT_PERIOD_NS: Final = 500_000_000
"""Time between two texts of the state [ns]."""
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
        self._next_text_ns = 0

    def draw(self, now_ns: int) -> None:
        """Draw everything received since the last call.

        Args:
            now_ns: Present time [ns, host clock].
        """
        received, page = self._received, self._page
        page.at(now_ns)
        self._draw_events()
        self._draw_frame()
        if (contact := received.contact) is not None:
            page.contact(contact_outline(contact) if contact.located else None)
        for name, line in (('force', 'force/estimate'), ('reference', 'force/reference')):
            if samples := drained(getattr(received, name)):
                self._latest[name] = samples[-1][1]
                page.curve(line, samples)
        if now_ns >= self._next_text_ns:
            self._next_text_ns = now_ns + TEXT_PERIOD_NS
            page.text(self._state(now_ns * 1e-9))

    def _draw_events(self) -> None:
        messages = drained(self._received.packets)
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

    def _state(self, now_s: float) -> str:
        received = self._received
        rates = {name: meter.read(now_s) for name, meter in received.meters.items()}
        gaps = f'{received.counter.lost} lost, {received.skipped} not drawn'
        slip = 'not running'
        if received.slip is not None:
            slip = '**SLIP**' if received.slip.slipping else 'stable'
            slip += f', {received.slip.count:g} events of {received.slip.threshold:g}'
        rows = [
            *(
                f'{name} | **{_newtons(force)}** at {rates[name]:.0f} Hz'
                for name, force in self._latest.items()
            ),
            f'contact | {_place(received.contact)}',
            f'slip | {slip}',
            f'events | {rates["events"] / 1000:.1f} k/s',
            f'packets | {rates["packets"]:.0f} /s; {gaps}',
            f'frames | {rates["frames"]:.1f} /s',
            f'undecodable | {self.undecodable}',
        ]
        nodes = [
            f'{name} | {_LEVELS[min(level, 3)]}: {message.replace("|", "/")}'
            for name, (level, message) in sorted(received.nodes.items())
        ]
        return '| | |\n|---|---|\n' + '\n'.join(f'| {row} |' for row in rows + nodes)


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
