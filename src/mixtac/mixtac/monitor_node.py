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
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import cached_property, partial
from typing import Any, Final, TypeVar

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from numpy.typing import NDArray
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import Image, TimeReference
from std_srvs.srv import Trigger

from mixtac_core.node import topics
from mixtac_core.node.base_node import BaseNode, starting
from mixtac_core.node.graph import NodeSpec
from mixtac_core.node.process import GraphError, ProcessGroup
from mixtac_core.node.stamps import stamp_to_ns
from mixtac_msgs.srv import Touch

N = TypeVar('N', bound='CommandNode')
DEPTH: Final = 1000
"""Forces that may wait: those of two seconds in which the host has no time for the monitor."""
MOST_HZ: Final = 1100
"""Highest rate of forces and of the reference that `Monitor` keeps [Hz]."""
LOG_PATIENCE_S: Final = 3.0
"""Longest time until the log of a refusal arrives after its answer [s]."""
REPORT_PERIOD_S: Final = 10.0
"""Time between two lines on what is waited for [s]."""


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


class Series:
    """Forces of one topic in the order of their arrival; one thread adds, any thread reads.

    Args:
        size: Most samples that are kept; later ones are only counted.

    Attributes:
        received: Samples so far.
        latest_n: Latest normal force [N], NaN before the first.
    """

    def __init__(self, size: int) -> None:
        self.received = 0
        self.latest_n = float('nan')
        self._times_ns = np.zeros((2, size), np.int64)
        self._force_n = np.zeros((size, 3))

    def add(self, message: topics.ForceMessage) -> None:
        """Add a sample that arrives now."""
        place, self.latest_n = self.received, topics.normal_force(message)
        if place < len(self._force_n):
            self._times_ns[:, place] = time.time_ns(), stamp_to_ns(message.header.stamp)
            self._force_n[place] = *topics.sideways_force(message), self.latest_n
        self.received = place + 1

    @property
    def count(self) -> int:
        """Number of samples kept."""
        return min(self.received, len(self._force_n))

    @property
    def times_ns(self) -> NDArray[np.int64]:
        """Arrival [ns, host clock] and stamp [ns] of each sample, shape (2, N), a view."""
        return self._times_ns[:, : self.count]

    @property
    def force_n(self) -> NDArray[np.float64]:
        """Force along x, y and normal of each sample [N], shape (N, 3), a view."""
        return self._force_n[: self.count]


class Monitor(Receiver):
    """Measures what the nodes of a sensor publish, and calls their services.

    Args:
        namespace: Namespace of the sensor.
        seconds: Longest time to keep samples for.

    Attributes:
        diagnostics: Latest values by node name and key.
        estimate: Forces of the estimator, stamps on the camera clock.
        measured: Forces of the reference sensor.
        serial: Serial number of the camera, empty before its first clock message.
    """

    def __init__(self, namespace: str, seconds: float) -> None:
        super().__init__('monitor', namespace)
        size = int(MOST_HZ * seconds) + DEPTH
        self.estimate, self.measured = Series(size), Series(size)
        self.diagnostics: dict[str, dict[str, str]] = {}
        self.serial = ''
        self._clients: dict[str, Any] = {}

    def bring_up_all(self, nodes: Sequence[NodeSpec], processes: ProcessGroup) -> None:
        """Configure and activate the lifecycle nodes of these processes; before `listen`.

        Waits as long as the processes run: a first start compiles.

        Raises:
            GraphError: That failed.
        """
        for name in [node.name for node in nodes if node.lifecycle]:
            for transition in (Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE):
                request = ChangeState.Request(transition=Transition(id=transition))
                reply = self._call(ChangeState, f'{name}/change_state', request, processes.check)
                if not reply.success:
                    end_s = time.monotonic() + LOG_PATIENCE_S
                    while not (why := processes.last_error(name)) and time.monotonic() < end_s:
                        time.sleep(0.05)
                    raise GraphError(f'{name} could not be started: {why or "see its log"}')

    def listen(self) -> None:
        """Subscribe and start receiving."""
        node = self._node
        node.subscribe_topic(replace(topics.FORCE, depth=DEPTH), self.estimate.add)
        node.subscribe_topic(topics.REFERENCE_WRENCH, self.measured.add)
        node.subscribe_topic(topics.CAMERA_CLOCK, self._on_clock)
        node.subscribe_topic(topics.DIAGNOSTICS, self._on_diagnostics)
        self._thread.start()

    def trigger(self, service: str, alive: Callable[[], None]) -> None:
        """Call a Trigger service by its relative name; before `listen` or while listening.

        Raises:
            GraphError: It refuses.
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

    def _call(self, kind: Any, service: str, request: Any, alive: Callable[[], None]) -> Any:  # noqa: ANN401
        # One client for all calls: the answer to a new one can get lost while it is discovered.
        if service not in self._clients:
            self._clients[service] = self._node.create_client(kind, service)
        client = self._clients[service]
        self.wait(client.service_is_ready, f'the service {service}', alive)
        future = client.call_async(request)
        self.wait(future.done, f'the answer of {service}', alive)
        return future.result()

    def wait_for_force(self, check: Callable[[], None]) -> None:
        """Wait, while listening, until the estimator publishes.

        Args:
            check: Called while waiting; raises when a process has ended.
        """
        self.wait(lambda: self.estimate.received > 0, 'the first force', check)

    def wait(self, done: Callable[[], bool], what: str, alive: Callable[[], None]) -> None:
        """Wait until `done` returns True. A busy computer is slow, so there is no time limit.

        Args:
            done: Called often.
            what: What is waited for; shown every ten seconds with the messages of the nodes.
            alive: Called often; raises when a process has ended.
        """
        began_s = time.monotonic()
        due_s = began_s + REPORT_PERIOD_S
        while not done():
            alive()
            if self._thread.is_alive():
                time.sleep(0.02)
            else:
                rclpy.spin_once(self._node, timeout_sec=0.1)
            if (now_s := time.monotonic()) > due_s:
                due_s += REPORT_PERIOD_S
                said = [f'{name}: {each["message"]}' for name, each in self.diagnostics.items()]
                text = '; '.join([f'waiting for {what} for {now_s - began_s:.0f} s', *said])
                self._node.get_logger().info(text)

    def values(self, node: str) -> dict[str, str]:
        """Return the latest diagnostics of a node of the sensor by key, and its `message`."""
        return self.diagnostics.get(topics.absolute(node, self._namespace).lstrip('/'), {})

    @property
    def force_count(self) -> int:
        """Return the number of forces kept."""
        return self.estimate.count

    def force(self) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
        """Return arrival [ns, host clock], stamp [ns, camera clock] and force [N], as views."""
        n = self.estimate.count
        arrival_ns, stamp_ns = self.estimate.times_ns[:, :n]
        return arrival_ns, stamp_ns, self.estimate.force_n[:n, 2]

    def sideways(self) -> NDArray[np.float64]:
        """Return the sideways force of each sample of `force` [N], [T, 2], as a view."""
        return self.estimate.force_n[:, :2]

    @property
    def reference_count(self) -> int:
        """Return the number of reference samples kept."""
        return self.measured.count

    def reference(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return arrival [ns, host clock] and reference force [N], as views."""
        n = self.measured.count
        return self.measured.times_ns[0, :n], self.measured.force_n[:n, 2]

    def reference_sideways(self) -> NDArray[np.float64]:
        """Return the force along x and y of each sample of `reference` [N], [T, 2], as a view."""
        return self.measured.force_n[:, :2]

    def _on_clock(self, message: TimeReference) -> None:
        self.serial = message.source

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
