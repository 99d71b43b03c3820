# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Nodes of the command line.

`CommandNode` is the one node of a command; a `Receiver` spins it in a thread of its own. `Monitor`
measures forces, clocks and diagnostics as any user's node would see them; `ImageReceiver` keeps the
newest image of a topic.
"""

from __future__ import annotations

import math
import threading
import time
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import cached_property, partial
from typing import Any, TypeVar

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from numpy.typing import NDArray
from rcl_interfaces.srv import SetParameters
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from rclpy.topic_endpoint_info import TopicEndpointInfo
from sensor_msgs.msg import Image, TimeReference
from std_srvs.srv import Trigger

from mixtac_msgs.srv import Touch
from mixtac_node import topics
from mixtac_node.base_node import BaseNode, starting
from mixtac_node.graph import NodeSpec
from mixtac_node.lifecycle_node import LifecycleClient
from mixtac_node.process import GraphError, ProcessGroup
from mixtac_node.stamps import stamp_to_ns

N = TypeVar('N', bound='CommandNode')
SERVICE_TIMEOUT_S = 20.0
DEPTH = 1000
"""Forces that may wait: those of two seconds in which the host has no time for the monitor."""
FIRST_FORCE_TIMEOUT_S = 180.0
"""The driver compiles, too, before its first packet."""


class CommandNode(BaseNode, Node):  # type: ignore[misc]
    """A node within a command, outside of any other rclpy program."""

    @classmethod
    @contextmanager
    def opened(cls: type[N], name: str, namespace: str) -> Iterator[N]:  # noqa: PYI019
        """Yield the node; it is closed at the end of the `with` block.

        Args:
            name: Name of the node.
            namespace: Its namespace.
        """
        with starting():
            rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
            node = cls(name, namespace=f'/{namespace.strip("/")}')
        try:
            yield node
        finally:
            node.destroy_node()
            rclpy.try_shutdown()

    def spin_for(self, seconds: float, stopping: Callable[[], bool]) -> None:
        """Receive for some seconds, or until `stopping` returns True; always in the same thread.

        Args:
            seconds: How long [s].
            stopping: Called several times a second.
        """
        end_s = time.monotonic() + seconds
        while not stopping() and (left_s := end_s - time.monotonic()) > 0 and rclpy.ok():
            self._spinner.spin_once(timeout_sec=min(left_s, 0.1))

    @cached_property
    def _spinner(self) -> EventsExecutor:
        executor = EventsExecutor()
        executor.add_node(self)
        return executor


class Receiver(ExitStack):
    """A node that receives in a thread of its own, until the end of a `with` block.

    Args:
        name: Name of the node.
        namespace: Its namespace.
    """

    def __init__(self, name: str, namespace: str = topics.DEFAULT_NAMESPACE) -> None:
        super().__init__()
        self._namespace = namespace
        self._node = self.enter_context(CommandNode.opened(name, namespace))
        self._stopping = threading.Event()
        self.callback(self._stop)
        spin = partial(self._node.spin_for, math.inf, self._stopping.is_set)
        self._thread = threading.Thread(target=spin, name=name)

    def _stop(self) -> None:
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join()


class Monitor(Receiver):
    """Measures what the nodes of a sensor publish, and calls their services.

    Args:
        namespace: Namespace of the sensor.
        seconds: Longest time to keep samples for.

    Attributes:
        diagnostics: Latest values by node name and key.
        reference_n: Latest reference force [N], NaN before the first.
        serial: Serial number of the camera, empty before its first clock message.
    """

    def __init__(self, namespace: str, seconds: float) -> None:
        super().__init__('monitor', namespace)
        size = int(600 * seconds) + 1000
        self._arrival_ns = np.zeros(size, np.int64)
        self._stamp_ns = np.zeros(size, np.int64)
        self._force = np.zeros(size)
        self._across = np.zeros((size, 2))
        self._count = 0
        self.diagnostics: dict[str, dict[str, str]] = {}
        self.reference_n = float('nan')
        self._clients: dict[str, Any] = {}
        self._reference_ns = array('q')
        self._reference = array('d')
        self._reference_across = array('d')
        self.serial = ''
        self._clock_pairs: list[tuple[int, int]] = []

    def bring_up(self, name: str, processes: ProcessGroup) -> None:
        """Configure and activate a lifecycle node of these processes; before `listen`.

        Waits as long as the processes run: a first start compiles.

        Raises:
            GraphError: That failed.
        """
        LifecycleClient(
            self._node,
            topics.absolute(name, self._namespace),
            processes.check,
            lambda: processes.last_error(name),
            timeout_s=math.inf,
        ).bring_up()

    def bring_up_all(self, nodes: Sequence[NodeSpec], processes: ProcessGroup) -> None:
        """Bring up the lifecycle nodes among these, as `bring_up` does."""
        for node in nodes:
            if node.lifecycle:
                self.bring_up(node.name, processes)

    def listen(self) -> None:
        """Subscribe and start receiving."""
        node = self._node
        node.subscribe_topic(replace(topics.FORCE, depth=DEPTH), self._on_force)
        node.subscribe_topic(topics.REFERENCE_WRENCH, self._on_reference)
        node.subscribe_topic(topics.CAMERA_CLOCK, self._on_clock)
        node.subscribe_topic(topics.DIAGNOSTICS, self._on_diagnostics)
        self._thread.start()

    def trigger(self, service: str, alive: Callable[[], None]) -> None:
        """Call a Trigger service by its relative name; before `listen` or while listening.

        Raises:
            GraphError: It is absent or refuses.
        """
        self._request(Trigger, service, Trigger.Request(), alive)

    def touch(self, gesture: str, alive: Callable[[], None], **values: float) -> None:
        """Touch the virtual sensor; before `listen` or while listening.

        Args:
            gesture: As in `mixtac_msgs/srv/Touch`.
            alive: Called while waiting; raises when a process has ended.
            **values: Fields of that request; those that are absent have their defaults.

        Raises:
            GraphError: The sensor is absent or refuses.
        """
        request = Touch.Request(gesture=gesture, **values)
        self._request(Touch, 'virtual_sensor/touch', request, alive)

    def _request(self, kind: Any, service: str, request: Any, alive: Callable[[], None]) -> None:  # noqa: ANN401
        reply = self._call(kind, service, request, alive)
        if not reply.success:
            raise GraphError(f'{topics.absolute(service, self._namespace)}: {reply.message}')

    def set_parameters(
        self, node: str, values: Mapping[str, object], alive: Callable[[], None]
    ) -> None:
        """Set parameters of a node of the sensor; before `listen` or while listening.

        Raises:
            GraphError: The node is absent or refuses.
        """
        request = SetParameters.Request()
        request.parameters = [
            Parameter(name, value=value).to_parameter_msg() for name, value in values.items()
        ]
        service = f'{node}/set_parameters'
        for result in self._call(SetParameters, service, request, alive).results:
            if not result.successful:
                raise GraphError(f'{topics.absolute(node, self._namespace)}: {result.reason}')

    def _call(self, kind: Any, service: str, request: Any, alive: Callable[[], None]) -> Any:  # noqa: ANN401
        # One client for all calls: the answer to a new one can get lost while it is discovered.
        if service not in self._clients:
            self._clients[service] = self._node.create_client(kind, service)
        client, name = self._clients[service], topics.absolute(service, self._namespace)
        if not client.wait_for_service(timeout_sec=SERVICE_TIMEOUT_S):
            raise GraphError(f'service {name} did not appear')
        future = client.call_async(request)
        deadline = time.monotonic() + SERVICE_TIMEOUT_S
        while not future.done():
            alive()
            if self._thread.is_alive():
                time.sleep(0.02)
            else:
                rclpy.spin_once(self._node, timeout_sec=0.1)
            if time.monotonic() > deadline:
                raise GraphError(f'service {name} did not answer')
        return future.result()

    def wait_for_force(self, check: Callable[[], None]) -> None:
        """Wait, while listening, until the estimator publishes.

        Args:
            check: Called while waiting; raises when a process has ended.

        Raises:
            GraphError: No force came; the text holds the last diagnostics of the estimator.
        """
        deadline = time.monotonic() + FIRST_FORCE_TIMEOUT_S
        while self.force_count == 0:
            time.sleep(0.05)
            check()
            if time.monotonic() > deadline:
                message = self.values('fger').get('message', 'none')
                raise GraphError(
                    f'no force in {FIRST_FORCE_TIMEOUT_S:.0f} s; diagnostics of fger: {message}'
                )

    def values(self, node: str) -> dict[str, str]:
        """Return the latest diagnostics of a node of the sensor by key, and its `message`."""
        return self.diagnostics.get(topics.absolute(node, self._namespace).lstrip('/'), {})

    @property
    def force_count(self) -> int:
        """Return the number of force samples received."""
        return self._count

    def force(self) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
        """Return arrival [ns, host clock], stamp [ns, camera clock] and force [N], as views."""
        n = self._count
        return self._arrival_ns[:n], self._stamp_ns[:n], self._force[:n]

    def sideways(self) -> NDArray[np.float64]:
        """Return the sideways force of each sample of `force` [N], [T, 2], as a view."""
        return self._across[: self._count]

    @property
    def reference_count(self) -> int:
        """Return the number of reference samples received."""
        return len(self._reference)

    def reference(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return arrival [ns, host clock] and reference force [N]."""
        n = len(self._reference)
        return np.array(self._reference_ns[:n]), np.array(self._reference[:n])

    def reference_sideways(self) -> NDArray[np.float64]:
        """Return the force along x and y of each sample of `reference` [N], [T, 2]."""
        n = 2 * len(self._reference)
        return np.array(self._reference_across[:n]).reshape(-1, 2)

    def clock_pairs(self) -> NDArray[np.int64]:
        """Return (host, camera) clock pairs [ns], shape (N, 2), as the driver published them."""
        return np.array(self._clock_pairs, np.int64).reshape(-1, 2)

    def publishers(self, topic: str) -> list[TopicEndpointInfo]:
        """Return type and QoS of all publishers of an absolute topic."""
        return list(self._node.get_publishers_info_by_topic(topic))

    def _on_force(self, message: topics.ForceMessage) -> None:
        arrival = time.time_ns()
        i = self._count
        if i == len(self._force):
            return
        self._arrival_ns[i] = arrival
        self._stamp_ns[i] = stamp_to_ns(message.header.stamp)
        self._force[i] = topics.normal_force(message)
        self._across[i] = topics.sideways_force(message)
        self._count = i + 1

    def _on_reference(self, message: topics.ForceMessage) -> None:
        self.reference_n = topics.normal_force(message)
        self._reference_ns.append(time.time_ns())
        self._reference_across.extend(topics.sideways_force(message))
        self._reference.append(self.reference_n)

    def _on_clock(self, message: TimeReference) -> None:
        self.serial = message.source
        self._clock_pairs.append((stamp_to_ns(message.header.stamp), stamp_to_ns(message.time_ref)))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = {each.key: each.value for each in status.values}
            self.diagnostics[status.name] = {'message': status.message, **values}


class ImageReceiver(Receiver):
    """Keeps the newest image of a topic; an image that nobody took is replaced by the next.

    Args:
        topic: Absolute name of the topic.
    """

    def __init__(self, topic: str) -> None:
        super().__init__('calibrate')
        self._fresh = threading.Condition()
        self._newest: Image | None = None
        self._node.subscribe_topic(topics.IMAGE_RAW, self._on_image, name=topic)
        self._thread.start()

    def take(self, timeout_s: float) -> Image | None:
        """Return the newest image not yet taken, or None if there is none in time."""
        with self._fresh:
            self._fresh.wait_for(lambda: self._newest is not None, timeout_s)
            image, self._newest = self._newest, None
            return image

    def _on_image(self, message: Image) -> None:
        with self._fresh:
            self._newest = message
            self._fresh.notify()
