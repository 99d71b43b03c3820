# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The live view node: subscribes, and draws in a thread of its own."""

from __future__ import annotations

import threading
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from rclpy.node import Node

from mixtac_cli.parameters import ViewParameters
from mixtac_cli.view.drawing import Drawing, Received, palette
from mixtac_cli.view.server import ViewError, ViewerServer, require_rerun
from mixtac_events.codec import warm_up
from mixtac_node import topics
from mixtac_node.base_node import BaseNode, declare, run
from mixtac_node.diagnostics import OK, WARN, DiagnosticsPublisher, Status
from mixtac_node.files import writable

if TYPE_CHECKING:
    from mixtac_cli.view.drawing import Curve
    from mixtac_cli.view.page import Page


class ViewNode(BaseNode, Node):  # type: ignore[misc]
    """Only subscribes, best effort, so that no publisher ever waits for the view."""

    def __init__(self) -> None:
        super().__init__('view')
        self._settings = declare(self, ViewParameters)
        self._server: ViewerServer | None = None
        self._failure: Exception | None = None
        self._stopping = threading.Event()
        self._received = Received()
        self._page = self._open_page()
        self._diagnostics = DiagnosticsPublisher(self, 'view', self._status)
        with self._diagnostics.compiling('the packet codec'):
            warm_up()
        self._drawing = Drawing(self._received, self._page)
        self._subscribe()
        self._thread = threading.Thread(target=self._draw, name='view')
        self._thread.start()

    def check(self) -> None:
        """Raise a ViewError if drawing or the server has stopped."""
        if self._server is not None:
            self._server.check()
        if self._failure is not None:
            raise ViewError(f'the live view stopped: {self._failure}')

    def close(self) -> None:
        """Stop drawing, then the server."""
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
            path = Path(p.save)
            if path.exists():
                raise ViewError(f'{path} exists', remedy='name a new file in `save`')
            writable(path)
            path.parent.mkdir(parents=True, exist_ok=True)
            self.get_logger().info(f'writing {path}')
            return Page(p.history, palette(), path=path)
        self._server = ViewerServer(p.port, p.data_port, p.memory)
        self.get_logger().info(f'live view: {self._server.page_url}')
        return Page(p.history, palette(), url=self._server.data_url)

    def _subscribe(self) -> None:
        received = self._received
        self.subscribe_topic(topics.EVENTS, lambda m: received.packets.add(m, m.seq))
        self.subscribe_topic(topics.IMAGE_RAW, received.on_frame)
        self.subscribe_topic(topics.CONTACT, received.on_contact)
        self.subscribe_topic(topics.DISPLACEMENT, received.on_field)
        self.subscribe_topic(topics.FORCE, partial(self._plot, received.force))
        reference = self._settings.reference_topic
        plot_reference = partial(self._plot, received.reference)
        self.subscribe_topic(topics.REFERENCE_WRENCH, plot_reference, name=reference)
        self.subscribe_topic(topics.SLIP, lambda m: received.on_slip(m, time.time_ns()))
        self.subscribe_topic(topics.DIAGNOSTICS, received.on_diagnostics)

    @staticmethod
    def _plot(curve: Curve, message: topics.ForceMessage) -> None:
        curve.add(time.time_ns(), topics.normal_force(message))

    def _draw(self) -> None:
        period = 1.0 / self._settings.rate
        due = time.monotonic() + period
        while not self._stopping.wait(max(0.0, due - time.monotonic())):
            try:
                self._drawing.draw(time.time_ns())
            except Exception as error:  # noqa: BLE001  (check raises it in the main thread)
                self._failure = error
                return
            # Late pictures are skipped.
            due = max(due + period, time.monotonic() + 0.2 * period)

    def _status(self) -> Status:
        received = self._received
        bad = self._drawing.undecodable
        values: dict[str, object] = {
            'packets not drawn': received.packets.skipped,
            'packets lost': received.packets.counter.lost,
            'undecodable': bad,
            'samples dropped': received.force.dropped + received.reference.dropped,
            'page': self._server.page_url if self._server else self._settings.save,
        }
        return Status(WARN if bad else OK, f'{bad} undecodable' if bad else 'showing', values)


main = partial(run, ViewNode)
