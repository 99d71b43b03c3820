# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The live view node: subscribes, and draws in a thread of its own."""

from __future__ import annotations

import threading
import time
from functools import partial
from pathlib import Path

from rclpy.node import Node

from mixtac.parameters import ViewParameters
from mixtac.view import Drawing, Page, Received, ViewError, ViewerServer, require_rerun
from mixtac_core.events.codec import warm_up
from mixtac_core.node import topics
from mixtac_core.node.base_node import BaseNode, declare, run
from mixtac_core.node.diagnostics import OK, WARN, DiagnosticsPublisher, Status
from mixtac_core.node.files import writable


class ViewNode(BaseNode, Node):  # type: ignore[misc]
    """Only subscribes, best effort, so that no publisher ever waits for the view."""

    def __init__(self) -> None:
        super().__init__('view')
        self._settings = declare(self, ViewParameters)
        self._server: ViewerServer | None = None
        self._failure: Exception | None = None
        self._stopping = threading.Event()
        self._received = Received()
        page = self._open_page()
        self._diagnostics = DiagnosticsPublisher(self, 'view', self._status)
        with self._diagnostics.compiling('the packet codec'):
            warm_up()
        self._drawing = Drawing(self._received, page)
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
        self._drawing.close(time.time_ns())
        if self._server is not None:
            self._server.close()

    def _open_page(self) -> Page:
        require_rerun()
        p = self._settings
        if p.save:
            path = Path(p.save)
            if path.exists():
                raise ViewError(f'{path} exists', remedy='name a new file in `save`')
            writable(path)
            path.parent.mkdir(parents=True, exist_ok=True)
            self.get_logger().info(f'writing {path}')
            return Page(p.history, path=path)
        self._server = ViewerServer(p.port, p.data_port, p.memory)
        self.get_logger().info(f'live view: {self._server.page_url}')
        return Page(p.history, url=self._server.data_url)

    def _subscribe(self) -> None:
        received = self._received

        def force(name: str, message: topics.ForceMessage) -> None:
            received.on_force(name, time.time_ns(), topics.normal_force(message))

        self.subscribe_topic(topics.EVENTS, lambda m: received.on_packet(m, m.seq))
        self.subscribe_topic(topics.IMAGE_RAW, received.on_frame)
        self.subscribe_topic(topics.CONTACT, partial(setattr, received, 'contact'))
        self.subscribe_topic(topics.SLIP, partial(setattr, received, 'slip'))
        self.subscribe_topic(topics.DIAGNOSTICS, received.on_diagnostics)
        self.subscribe_topic(topics.FORCE, partial(force, 'force'))
        name = self._settings.reference_topic
        self.subscribe_topic(topics.REFERENCE_WRENCH, partial(force, 'reference'), name=name)

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
        received, bad = self._received, self._drawing.undecodable
        values: dict[str, object] = {
            'packets not drawn': received.skipped,
            'packets lost': received.counter.lost,
            'undecodable': bad,
            'page': self._server.page_url if self._server else self._settings.save,
        }
        return Status(WARN if bad else OK, f'{bad} undecodable' if bad else 'showing', values)


main = partial(run, ViewNode)
