# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A subscriber that keeps the newest image of a topic."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

import rclpy
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import Image

from mixtac_node.base_node import QOS_SENSOR

if TYPE_CHECKING:
    from types import TracebackType


class ImageReceiver:
    """Receives in a thread of its own; an image that nobody took is replaced by the next.

    Args:
        topic: Absolute name of the topic.

    Attributes:
        received: Images received.
        skipped: Images replaced before anybody took them.
    """

    def __init__(self, topic: str) -> None:
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        self._node = Node('calibrate')
        self._node.create_subscription(Image, topic, self._on_image, QOS_SENSOR)
        self._fresh = threading.Condition()
        self._newest: Image | None = None
        self.received = 0
        self.skipped = 0
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._spin, name='image-receiver')
        self._thread.start()

    def __enter__(self) -> ImageReceiver:
        """Return the receiver."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Stop receiving and close the node."""
        self._stopping.set()
        self._thread.join()
        self._node.destroy_node()
        rclpy.try_shutdown()

    def take(self, timeout_s: float) -> Image | None:
        """Return the newest image not yet taken, or None if there is none in time."""
        with self._fresh:
            self._fresh.wait_for(lambda: self._newest is not None, timeout_s)
            image, self._newest = self._newest, None
            return image

    def _on_image(self, message: Image) -> None:
        with self._fresh:
            self.received += 1
            self.skipped += self._newest is not None
            self._newest = message
            self._fresh.notify()

    def _spin(self) -> None:
        executor = EventsExecutor()
        executor.add_node(self._node)
        while not self._stopping.is_set() and rclpy.ok():
            executor.spin_once(timeout_sec=0.1)
        executor.remove_node(self._node)
