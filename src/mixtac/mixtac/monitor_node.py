# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Nodes of the command line.

`CommandNode` is the node of a command that uses ROS. `Monitor` receives forces and diagnostics in
its own thread, as any user's node would.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import cached_property, partial
from typing import Any, Final, TypeVar

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from numpy.typing import NDArray
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import TimeReference
from std_srvs.srv import Trigger

from mixtac_core.node import topics
from mixtac_core.node.base_node import BaseNode, starting
from mixtac_core.node.process import GraphError, ProcessGroup
from mixtac_core.node.topics import stamp_to_ns
from mixtac_msgs.srv import Touch

N = TypeVar('N', bound='CommandNode')
DEPTH: Final = 1000
"""Forces that may wait: two seconds in which the host has no time for the monitor."""
MOST_HZ: Final = 1100
"""Highest rate of forces and of the reference that `Monitor` keeps [Hz]."""
REPORT_PERIOD_S: Final = 10.0
"""Time between two progress lines while waiting [s]."""


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
            # ROS must not read the arguments of the command, which need not be UTF-8.
            rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
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
            self._force_n[place] = self.latest_n, *topics.sideways_force(message)
        self.received = place + 1

    def samples(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return the samples, as views.

        Returns:
            Arrival [ns, host clock] and stamp [ns] of each sample, shape (2, N), and its normal
            force and force along x and y [N], shape (N, 3).
        """
        kept = min(self.received, len(self._force_n))
        return self._times_ns[:, :kept], self._force_n[:kept]


class Monitor(ExitStack):
    """Measures what the nodes of a sensor publish, and calls their services.

    Args:
        namespace: Namespace of the sensor.
        processes: The nodes; waiting ends with an error when one has ended.
        seconds: Longest time to keep samples for.

    Attributes:
        processes: As given.
        diagnostics: Latest values by node name and key.
        estimate: Forces of the estimator, stamps on the camera clock.
        measured: Forces of the reference sensor.
        serial: Serial number of the camera, empty before its first clock message.
    """

    def __init__(self, namespace: str, processes: ProcessGroup, seconds: float = 0.0) -> None:
        super().__init__()
        self._namespace, self.processes = namespace, processes
        self._node = self.enter_context(CommandNode.opened('monitor', namespace))
        self._stopping = threading.Event()
        self.callback(self._stop)
        spin = partial(self._node.spin_for, math.inf, self._stopping.is_set)
        self._thread = threading.Thread(target=spin, name='monitor')
        size = int(MOST_HZ * seconds) + DEPTH
        self.estimate, self.measured = Series(size), Series(size)
        self.diagnostics: dict[str, dict[str, str]] = {}
        self.serial = ''
        self._clients: dict[str, Any] = {}

    def listen(self, reference: str = topics.REFERENCE) -> None:
        """Subscribe and start receiving; `reference` is the topic of the reference force."""
        node = self._node
        node.subscribe_topic(replace(topics.FORCE, depth=DEPTH), self.estimate.add)
        node.subscribe_topic(topics.REFERENCE_WRENCH, self.measured.add, name=reference)
        node.subscribe_topic(topics.CAMERA_CLOCK, self._on_clock)
        node.subscribe_topic(topics.DIAGNOSTICS, self._on_diagnostics)
        self._thread.start()

    def trigger(self, service: str) -> None:
        """Call a Trigger service by its relative name; before `listen` or while listening.

        Raises:
            GraphError: It refuses.
        """
        self._call(Trigger, service, Trigger.Request())

    def touch(self, gesture: str, **values: float) -> None:
        """Touch the virtual sensor; before `listen` or while listening.

        Args:
            gesture: As in `mixtac_msgs/srv/Touch`.
            **values: Fields of that request; those that are absent have their defaults.

        Raises:
            GraphError: The sensor is absent or refuses.
        """
        self._call(Touch, 'virtual_sensor/touch', Touch.Request(gesture=gesture, **values))

    def _call(self, kind: Any, service: str, request: Any) -> None:  # noqa: ANN401
        # One client for all calls: the answer to a new one can get lost while it is discovered.
        if service not in self._clients:
            self._clients[service] = self._node.create_client(kind, service)
        client = self._clients[service]
        self.wait(client.service_is_ready, f'the service {service}')
        future = client.call_async(request)
        self.wait(future.done, f'the answer of {service}')
        if not (reply := future.result()).success:
            raise GraphError(f'{topics.absolute(service, self._namespace)}: {reply.message}')

    def wait(self, done: Callable[[], bool], what: str) -> None:
        """Wait until `done` returns True. A busy computer is slow, so there is no time limit.

        Args:
            done: Called often.
            what: Name of the awaited condition; shown every ten seconds with the messages of the
                nodes.

        Raises:
            GraphError: A process has ended.
        """
        began_s = time.monotonic()
        due_s = began_s + REPORT_PERIOD_S
        while not done():
            self.processes.check()
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

    def _stop(self) -> None:
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join()

    def _on_clock(self, message: TimeReference) -> None:
        self.serial = message.source

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = {each.key: each.value for each in status.values}
            self.diagnostics[status.name] = {'message': status.message, **values}
