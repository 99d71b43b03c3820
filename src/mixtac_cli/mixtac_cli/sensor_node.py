# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Camera driver and force estimator, or driver and slip control, as two nodes of one process.

Nodes, topics, services and parameters are those of the separate processes, but events and frames
reach the other node by a function call: less CPU, and no waiting for a thread. rclpy has no
intra-process transport: even within one process a message is serialised, passes through the
middleware, and wakes an executor thread that has to acquire the interpreter lock.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from functools import partial, wraps
from typing import Any

from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.publisher import Publisher

from mixtac_driver.node.driver_node import DriverNode
from mixtac_fger.fger_node import FgerNode
from mixtac_node.base_node import run_together
from mixtac_slip_control.slip_control_node import SlipControlNode


class DirectTopic:
    """A topic within the process.

    Callbacks are called in the thread that publishes, one message at a time and in order: nothing
    waits in a queue, and a slow callback delays its producer, which has a bounded queue.
    May be used from several threads.
    """

    def __init__(self) -> None:
        # Replaced as a whole, so that publishing needs no lock.
        self._callbacks: tuple[Callable[[Any], None], ...] = ()

    def __len__(self) -> int:
        """Return the number of callbacks."""
        return len(self._callbacks)

    def subscribe(self, callback: Callable[[Any], None]) -> None:
        """Pass messages to a callback from now on."""
        self._callbacks = (*self._callbacks, callback)

    def unsubscribe(self, callback: object) -> bool:
        """End a subscription and return whether there was one; a call in progress may finish."""
        before = self._callbacks
        self._callbacks = tuple(each for each in before if each is not callback)
        return len(self._callbacks) < len(before)

    def hand_over(self, message: Any) -> None:  # noqa: ANN401
        """Call all callbacks."""
        for callback in self._callbacks:
            callback(message)


class DirectPublisher:
    """Passes messages on within the process first, then publishes them.

    Messages go to the middleware only while another process subscribes.

    Args:
        publisher: The rclpy publisher.
        topic: The topic within the process.
    """

    def __init__(self, publisher: Publisher, topic: DirectTopic) -> None:
        self._publisher, self._topic = publisher, topic

    def get_subscription_count(self) -> int:
        """Return the number of subscribers inside and outside of the process."""
        return int(self._publisher.get_subscription_count()) + len(self._topic)

    def publish(self, message: Any) -> None:  # noqa: ANN401
        """Pass a message on and publish it."""
        self._topic.hand_over(message)
        if self._publisher.get_subscription_count():
            self._publisher.publish(message)


DIRECT = ('events', 'image_raw')


class _NamedDriver(Node):  # type: ignore[misc]
    """Keeps its name if the process is given one, which is for the lifecycle node."""

    def __init__(self, name: str, **options: Any) -> None:  # noqa: ANN401
        super().__init__(name, cli_args=['--ros-args', '-r', f'__node:={name}'], **options)


class DirectDriver(DriverNode, _NamedDriver):
    """The driver; its events and frames are also passed on within the process.

    Args:
        topics: Topics within the process, by name.
    """

    def __init__(self, topics: Mapping[str, DirectTopic]) -> None:
        self._direct_images = topics['image_raw']
        super().__init__(topics['events'])

    def create_publisher(self, kind: Any, topic: str, *args: Any, **options: Any) -> Any:  # noqa: ANN401
        """Create a publisher; for frames, one that serves both."""
        publisher = super().create_publisher(kind, topic, *args, **options)
        return (
            DirectPublisher(publisher, self._direct_images) if topic == 'image_raw' else publisher
        )


class _Direct(Node):  # type: ignore[misc]
    """A node that receives events and frames within the process.

    They arrive in the driver's thread, all else in the executor's: a lock separates them, as the
    single executor thread does in a process of its own.

    Args:
        topics: Topics within the process, by name.
    """

    def __init__(self, topics: Mapping[str, DirectTopic]) -> None:
        self._topics = topics
        self._lock = threading.RLock()
        super().__init__()

    def create_subscription(
        self,
        kind: Any,  # noqa: ANN401
        topic: str,
        callback: Callable[[Any], None],
        *args: Any,  # noqa: ANN401
        **options: Any,  # noqa: ANN401
    ) -> Any:  # noqa: ANN401
        """Subscribe; to topics within the process without the middleware."""
        direct, locked = self._topics.get(topic), self._locked(callback)
        if direct is None:
            return super().create_subscription(kind, topic, locked, *args, **options)
        direct.subscribe(locked)
        return locked

    def destroy_subscription(self, subscription: Any) -> bool:  # noqa: ANN401
        """End a subscription of either kind."""
        if any(topic.unsubscribe(subscription) for topic in self._topics.values()):
            return True
        return bool(super().destroy_subscription(subscription))

    def create_service(
        self,
        kind: Any,  # noqa: ANN401
        name: str,
        callback: Callable[..., Any],
        *args: Any,  # noqa: ANN401
        **options: Any,  # noqa: ANN401
    ) -> Any:  # noqa: ANN401
        """Create a service whose calls do not overlap with messages."""
        return super().create_service(kind, name, self._locked(callback), *args, **options)

    def create_timer(
        self,
        period_s: float,
        callback: Callable[..., Any],
        *args: Any,  # noqa: ANN401
        **options: Any,  # noqa: ANN401
    ) -> Any:  # noqa: ANN401
        """Create a timer whose calls do not overlap with messages."""
        return super().create_timer(period_s, self._locked(callback), *args, **options)

    def close(self) -> None:
        """End what the node does."""
        with self._lock:
            super().close()

    def _locked(self, callback: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(callback)
        def locked(*args: Any) -> Any:  # noqa: ANN401
            with self._lock:
                return callback(*args)

        return locked


class DirectFger(_Direct, FgerNode):
    """The estimator, which receives events and frames within the process."""

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start estimating."""
        with self._lock:
            return super().on_activate(state)


class DirectSlipControl(_Direct, SlipControlNode):
    """Slip control, which answers events in the driver's thread."""


def _make(node: type[_Direct]) -> list[Any]:
    """Return a node and the driver; call after `rclpy.init`."""
    topics = {name: DirectTopic() for name in DIRECT}
    # The driver last: if it cannot open its device the process ends.
    return [node(topics), DirectDriver(topics)]


main = partial(run_together, partial(_make, DirectFger))
main_slip = partial(run_together, partial(_make, DirectSlipControl))
