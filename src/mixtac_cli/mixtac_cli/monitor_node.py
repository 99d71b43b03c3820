# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Subscribers of the command line: they receive in a thread of their own.

`Monitor` measures forces, clocks and diagnostics as any user's node would see them;
`ImageReceiver` keeps the newest image of a topic.
"""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import Image, TimeReference
from std_srvs.srv import Trigger

from mixtac_node.base_node import QOS_FORCE, QOS_LATCHED, QOS_SENSOR
from mixtac_node.lifecycle_node import LifecycleClient
from mixtac_node.process import GraphError
from mixtac_node.stamps import stamp_to_ns
from mixtac_node.topics import REFERENCE

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import TracebackType

    from numpy.typing import NDArray
    from rclpy.topic_endpoint_info import TopicEndpointInfo

    from mixtac_node.process import ProcessGroup


SERVICE_TIMEOUT_S = 20.0
FIRST_FORCE_TIMEOUT_S = 60.0


class Monitor:
    """Runs a node in a thread of its own and keeps what it received.

    Args:
        namespace: Namespace of the sensor.
        seconds: Longest time to keep samples for.

    Attributes:
        diagnostics: Latest values by node name and key.
        reference_n: Latest reference force [N], NaN before the first.
        reference_count: Reference samples received.
    """

    def __init__(self, namespace: str, seconds: float) -> None:
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        self._namespace = f'/{namespace.strip("/")}'
        self._node = Node('monitor', namespace=self._namespace)
        size = int(600 * seconds) + 1000
        self._arrival_ns = np.zeros(size, np.int64)
        self._stamp_ns = np.zeros(size, np.int64)
        self._force = np.zeros(size)
        self._count = 0
        self.diagnostics: dict[str, dict[str, str]] = {}
        self.reference_n = float('nan')
        self.reference_count = 0
        self._clock_pairs: list[tuple[int, int]] = []
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None

    def __enter__(self) -> Monitor:
        """Return the monitor."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Stop receiving and close the node."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join()
        self._node.destroy_node()
        rclpy.try_shutdown()

    def bring_up(self, name: str, processes: ProcessGroup) -> None:
        """Configure and activate a lifecycle node of these processes; before `listen`.

        Raises:
            GraphError: That failed.
        """
        LifecycleClient(
            self._node,
            f'{self._namespace}/{name}',
            processes.check,
            lambda: processes.last_error(name),
        ).bring_up()

    def listen(self) -> None:
        """Subscribe and start receiving."""
        node = self._node
        node.create_subscription(WrenchStamped, 'force', self._on_force, QOS_FORCE)
        node.create_subscription(WrenchStamped, REFERENCE, self._on_reference, QOS_FORCE)
        node.create_subscription(TimeReference, 'camera_clock', self._on_clock, QOS_LATCHED)
        node.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, 20)
        self._thread = threading.Thread(target=self._spin, name='monitor')
        self._thread.start()

    def trigger(self, service: str, alive: Callable[[], None]) -> None:
        """Call a Trigger service by its relative name; before `listen` or while listening.

        Raises:
            GraphError: It is absent or refuses.
        """
        client = self._node.create_client(Trigger, service)
        if not client.wait_for_service(timeout_sec=SERVICE_TIMEOUT_S):
            raise GraphError(f'service {self._namespace}/{service} did not appear')
        future = client.call_async(Trigger.Request())
        deadline = time.monotonic() + SERVICE_TIMEOUT_S
        while not future.done():
            alive()
            if self._thread is None:
                rclpy.spin_once(self._node, timeout_sec=0.1)
            else:
                time.sleep(0.02)
            if time.monotonic() > deadline:
                raise GraphError(f'service {self._namespace}/{service} did not answer')
        reply = future.result()
        if not reply.success:
            raise GraphError(f'{self._namespace}/{service}: {reply.message}')

    def wait_for_force(self, check: Callable[[], None]) -> None:
        """Wait, while listening, until the estimator publishes.

        Args:
            check: Called while waiting; raises when a process has ended.

        Raises:
            GraphError: No force came; with what the estimator says of itself.
        """
        deadline = time.monotonic() + FIRST_FORCE_TIMEOUT_S
        while self.force_count == 0:
            time.sleep(0.05)
            check()
            if time.monotonic() > deadline:
                name = f'{self._namespace}/fger'.lstrip('/')
                said = self.diagnostics.get(name, {}).get('message', 'nothing')
                raise GraphError(f'no force in {FIRST_FORCE_TIMEOUT_S:.0f} s; fger says: {said}')

    @property
    def force_count(self) -> int:
        """Return the number of force samples received."""
        return self._count

    def force(self) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
        """Return arrival [ns, host clock], stamp [ns, camera clock] and force [N], as views."""
        n = self._count
        return self._arrival_ns[:n], self._stamp_ns[:n], self._force[:n]

    def clock_pairs(self) -> NDArray[np.int64]:
        """Return (host, camera) clock pairs [ns], shape (N, 2), as the driver published them."""
        return np.array(self._clock_pairs, np.int64).reshape(-1, 2)

    def publishers(self, topic: str) -> list[TopicEndpointInfo]:
        """Return type and QoS of everybody who publishes an absolute topic."""
        return list(self._node.get_publishers_info_by_topic(topic))

    def _spin(self) -> None:
        executor = EventsExecutor()
        executor.add_node(self._node)
        while not self._stopping.is_set() and rclpy.ok():
            executor.spin_once(timeout_sec=0.1)
        executor.remove_node(self._node)

    def _on_force(self, message: WrenchStamped) -> None:
        arrival = time.time_ns()
        i = self._count
        if i == len(self._force):
            return
        self._arrival_ns[i] = arrival
        self._stamp_ns[i] = stamp_to_ns(message.header.stamp)
        self._force[i] = message.wrench.force.z
        self._count = i + 1

    def _on_reference(self, message: WrenchStamped) -> None:
        self.reference_n = message.wrench.force.z
        self.reference_count += 1

    def _on_clock(self, message: TimeReference) -> None:
        self._clock_pairs.append((stamp_to_ns(message.header.stamp), stamp_to_ns(message.time_ref)))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = {each.key: each.value for each in status.values}
            self.diagnostics[status.name] = {'message': status.message, **values}


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
