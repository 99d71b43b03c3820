# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Draws what was received, once per picture; events of each picture as an image by polarity."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np

from mixtac_events.codec import decode_message
from mixtac_events.packets import CodecError
from mixtac_node.diagnostics import RateMeter
from mixtac_node.images import ImageConversionError, image_array

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_cli.view.buffers import Columns, Received
    from mixtac_events.arrays import Events


Colour = tuple[int, int, int]
BACKGROUND = (24, 26, 30)
BRIGHTER = (86, 180, 233)
"""Of Okabe and Ito's palette, which colour-blind people tell apart, as `DARKER`."""
DARKER = (230, 120, 20)
FULL = 3
"""Events of one polarity, more than of the other, at which a pixel has its full colour."""
STILL = FULL + 1
"""Level of a pixel without events, or with as many of both polarities. 0 is no level."""


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
        """Count events; their coordinates lie inside, as the decoder has checked."""
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


MOST_SAMPLES = 25
"""Samples per line and picture: 500 a second at 20 pictures."""
_TEXT_PERIOD_NS = 500_000_000
_LEVELS = ('ok', '**warning**', '**ERROR**', 'stale')


class Canvas(Protocol):
    """What is drawn on: `mixtac_cli.view.page.Page`."""

    def at(self, time_ns: int) -> None:
        """Set the time of pictures and texts."""

    def events(self, levels: NDArray[np.uint8]) -> None:
        """Show a picture of events."""

    def frame(self, pixels: NDArray[np.uint8]) -> None:
        """Show a frame."""

    def text(self, entity: str, markdown: str) -> None:
        """Show a text."""

    def curve(self, entity: str, columns: Columns) -> None:
        """Append samples to a line."""

    def show_slip(self) -> None:
        """Make room for the slip detection."""


class Drawing:
    """Takes what was received and draws it.

    Args:
        received: Where the subscriptions put it.
        canvas: What to draw on.

    Attributes:
        undecodable: Packets and frames that could not be decoded.
    """

    def __init__(self, received: Received, canvas: Canvas) -> None:
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
        """Draw everything that came since the last call.

        Args:
            now_ns: Present time [ns, host clock].
        """
        received, canvas = self._received, self._canvas
        canvas.at(now_ns)
        self._draw_events()
        self._draw_frame()
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

    def _draw_rates(self, now_ns: int) -> None:
        received = self._received
        totals = {
            'events': self._events,
            'packets': received.packets.packets,
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
        slip = {None: 'not watched', False: 'holds', True: '**SLIPS**'}[received.slipping]
        gaps = f'{received.packets.lost} lost, {received.packets.skipped} not drawn'
        lines = [
            '| | |',
            '|---|---|',
            f'| force | **{_newtons(received.force.latest)}** at {rates["force"]:.0f} Hz |',
            f'| reference | {_newtons(received.reference.latest)} at {rates["reference"]:.0f} Hz |',
            f'| slip | {slip} |',
            f'| events | {rates["events"] / 1000:.1f} k/s |',
            f'| packets | {rates["packets"]:.0f} /s; {gaps} |',
            f'| frames | {rates["frames"]:.1f} /s |',
            f'| undecodable | {self.undecodable} |',
            '',
            '| node | | says |',
            '|---|---|---|',
        ]
        for name, state in sorted(received.nodes.items()):
            said = state.message.replace('|', '/')
            lines.append(f'| {name} | {_LEVELS[min(state.level, 3)]} | {said} |')
        return '\n'.join(lines)


def _newtons(value: float) -> str:
    return 'none yet' if np.isnan(value) else f'{value:.2f} N'
