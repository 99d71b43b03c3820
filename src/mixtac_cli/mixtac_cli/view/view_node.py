# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The node of the live view: subscribes, and draws in a thread of its own."""

from __future__ import annotations

import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING

from diagnostic_msgs.msg import DiagnosticArray
from event_camera_msgs.msg import EventPacket
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from sensor_msgs.msg import Image

from mixtac_cli.parameters import ViewParameters
from mixtac_cli.view.buffers import Received
from mixtac_cli.view.drawing import Drawing
from mixtac_cli.view.server import ViewError, ViewerServer, require_rerun
from mixtac_events.codec import warm_up
from mixtac_msgs.msg import SlipState
from mixtac_node.base_node import QOS_EVENTS, QOS_FORCE, QOS_SENSOR, BaseNode, declare, run
from mixtac_node.diagnostics import OK, WARN, DiagnosticsPublisher, Status

if TYPE_CHECKING:
    from mixtac_cli.view.buffers import Curve
    from mixtac_cli.view.page import Page


class ViewNode(BaseNode, Node):  # type: ignore[misc]
    """Only listens: best-effort subscriptions, so that nobody ever waits for the view."""

    def __init__(self) -> None:
        super().__init__('view')
        self._settings = declare(self, ViewParameters)
        self._server: ViewerServer | None = None
        self._failure: Exception | None = None
        self._stopping = threading.Event()
        self._received = Received()
        self._page = self._open_page()
        warm_up()
        self._drawing = Drawing(self._received, self._page)
        self._subscribe()
        self._diagnostics = DiagnosticsPublisher(self, 'view', self._status)
        self._thread = threading.Thread(target=self._draw, name='view')
        self._thread.start()

    def check(self) -> None:
        """Raise a ViewError when the page cannot be fed any more."""
        if self._server is not None:
            self._server.check()
        if self._failure is not None:
            raise ViewError(f'the live view stopped: {self._failure}')

    def close(self) -> None:
        """End drawing, then the server."""
        self._stopping.set()
        self._thread.join()
        self._page.close()
        if self._server is not None:
            self._server.close()

    def _open_page(self) -> Page:
        require_rerun()
        from mixtac_cli.view.page import Page

        p = self._settings
        if p.save:
            if Path(p.save).exists():
                raise ViewError(f'{p.save} exists: name a new file in `save`')
            self.get_logger().info(f'writing {p.save}')
            return Page(p.history, path=Path(p.save))
        self._server = ViewerServer(p.port, p.data_port, p.memory)
        self.get_logger().info(f'live view: {self._server.page_url}')
        return Page(p.history, url=self._server.data_url)

    def _subscribe(self) -> None:
        received = self._received
        self.create_subscription(
            EventPacket, 'events', lambda m: received.packets.add(m, m.seq), QOS_EVENTS
        )
        self.create_subscription(Image, 'image_raw', received.on_frame, QOS_SENSOR)
        self._plot('force', received.force)
        self._plot(self._settings.reference_topic, received.reference)
        self.create_subscription(
            SlipState, 'slip', lambda m: received.on_slip(m, time.time_ns()), QOS_FORCE
        )
        self.create_subscription(DiagnosticArray, '/diagnostics', received.on_diagnostics, 20)

    def _plot(self, topic: str, curve: Curve) -> None:
        def keep(message: WrenchStamped) -> None:
            curve.add(time.time_ns(), message.wrench.force.z)

        self.create_subscription(WrenchStamped, topic, keep, QOS_FORCE)

    def _draw(self) -> None:
        period = 1.0 / self._settings.rate
        due = time.monotonic() + period
        while not self._stopping.wait(max(0.0, due - time.monotonic())):
            try:
                self._drawing.draw(time.time_ns())
            except Exception as error:  # noqa: BLE001  (told by check, where it ends the node)
                self._failure = error
                return
            # Late pictures are left out, not made up for.
            due = max(due + period, time.monotonic() + 0.2 * period)

    def _status(self) -> Status:
        received = self._received
        bad = self._drawing.undecodable
        values: dict[str, object] = {
            'packets not drawn': received.packets.skipped,
            'packets lost': received.packets.lost,
            'undecodable': bad,
            'samples dropped': received.force.dropped + received.reference.dropped,
            'page': self._server.page_url if self._server else self._settings.save,
        }
        return Status(WARN if bad else OK, f'{bad} undecodable' if bad else 'showing', values)


def main(args: list[str] | None = None) -> int:
    """Run the view node."""
    return run(ViewNode, args)


if __name__ == '__main__':
    sys.exit(main())
