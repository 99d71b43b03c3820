# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Publishing edges at the synchronisation connector."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

from mixtac_driver import messages
from mixtac_msgs.msg import ExternalEdge

if TYPE_CHECKING:
    from mixtac_driver.driver_meters import DriverMeters
    from mixtac_driver.readings import Edges

MOST_PER_SECOND = 2000.0
"""More than that would delay events."""
BURST = 500.0
QUEUE_DEPTH = 1000
"""Reliable: edges are few, and each may be somebody's trigger."""


class EdgePublisher:
    """Publishes edges on `external_edges`, up to MOST_PER_SECOND; counts the others as dropped.

    Args:
        node: An rclpy node.
        frame_id: Frame of the camera.
        meters: Where edges are counted.
    """

    def __init__(self, node: Any, frame_id: str, meters: DriverMeters) -> None:  # noqa: ANN401
        self._frame_id, self._meters = frame_id, meters
        self._publisher = node.create_publisher(ExternalEdge, 'external_edges', QUEUE_DEPTH)
        self._sequence = 0
        self._allowed = BURST
        self._allowed_at_s = time.monotonic()

    def publish(self, edges: Edges, origin_us: int) -> None:
        """Publish edges where somebody listens.

        Args:
            edges: The edges.
            origin_us: Origin of the camera's clock [us since the Unix epoch].
        """
        count, first = len(edges.t), self._sequence
        self._sequence += count
        self._meters.edges.add(count)
        if not count or not self._publisher.get_subscription_count():
            return
        published = min(count, self._budget())
        self._allowed -= published
        self._meters.edges_dropped += count - published
        for index in range(published):
            time_us = int(edges.t[index]) + origin_us
            kind = int(edges.kind[index])
            self._publisher.publish(
                messages.external_edge(kind, time_us, first + index, self._frame_id)
            )

    def _budget(self) -> int:
        now_s = time.monotonic()
        gained = (now_s - self._allowed_at_s) * MOST_PER_SECOND
        self._allowed_at_s = now_s
        self._allowed = min(self._allowed + gained, BURST)
        return int(self._allowed)
