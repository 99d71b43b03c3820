# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Camera driver and force estimator as two nodes of one process, which takes less CPU than two.

Nodes, topics, services and parameters are those of the separate processes. Events and frames reach
the estimator without the middleware. rclpy has no intra-process transport: within one process, too,
a message is serialised, handed to the middleware and picked up by an executor thread, which has to
be woken and to acquire the interpreter lock. Where one thread produces and the other only waits for
it, a function call does the same.
"""

from __future__ import annotations

import sys
import threading
from functools import wraps
from typing import TYPE_CHECKING, Any, Protocol

from rclpy.node import Node

from mixtac_driver.node.driver_node import DriverNode
from mixtac_fger.fger_node import FgerNode
from mixtac_node.base_node import run_together

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn


class RosPublisher(Protocol):
    """What is used of an rclpy publisher."""

    def publish(self, message: Any) -> None:  # noqa: ANN401
        """Send a message."""

    def get_subscription_count(self) -> int:
        """Return the number of subscriptions, of other processes or of this one."""


class DirectSubscription:
    """A callback that takes messages of a topic within the process; a handle to end it with."""

    def __init__(self, callback: Callable[[Any], None]) -> None:
        self.callback = callback


class DirectTopic:
    """A topic within the process.

    Callbacks are called in the thread that publishes, one message at a time and in order: nothing
    waits in a queue, and a slow callback holds up its producer, which has a bounded queue of its
    own. May be used from several threads.
    """

    def __init__(self) -> None:
        # Replaced as a whole, so that publishing needs no lock.
        self._subscriptions: tuple[DirectSubscription, ...] = ()

    def __len__(self) -> int:
        """Return the number of callbacks."""
        return len(self._subscriptions)

    def subscribe(self, callback: Callable[[Any], None]) -> DirectSubscription:
        """Have messages handed to a callback from now on."""
        subscription = DirectSubscription(callback)
        self._subscriptions = (*self._subscriptions, subscription)
        return subscription

    def unsubscribe(self, subscription: DirectSubscription) -> None:
        """End a subscription; a call that is under way may still finish."""
        self._subscriptions = tuple(s for s in self._subscriptions if s is not subscription)

    def hand_over(self, message: Any) -> None:  # noqa: ANN401
        """Call all callbacks."""
        for subscription in self._subscriptions:
            subscription.callback(message)


class DirectPublisher:
    """Hands messages over within the process first, then publishes them for everybody else.

    Nothing goes to the middleware while nobody outside of the process listens.

    Args:
        publisher: The rclpy publisher.
        topic: The topic within the process.
    """

    def __init__(self, publisher: RosPublisher, topic: DirectTopic) -> None:
        self._publisher, self._topic = publisher, topic

    def get_subscription_count(self) -> int:
        """Return the number of listeners inside and outside of the process."""
        return self._publisher.get_subscription_count() + len(self._topic)

    def publish(self, message: Any) -> None:  # noqa: ANN401
        """Hand a message over and publish it."""
        self._topic.hand_over(message)
        if self._publisher.get_subscription_count():
            self._publisher.publish(message)


DIRECT = ('events', 'image_raw')


class _NamedDriver(Node):  # type: ignore[misc]
    """Keeps its name where the process is given one: that is for the lifecycle node."""

    def __init__(self, name: str, **options: Any) -> None:  # noqa: ANN401
        super().__init__(name, cli_args=['--ros-args', '-r', f'__node:={name}'], **options)


class DirectDriver(DriverNode, _NamedDriver):
    """The driver, whose events and frames are also handed over within the process.

    Args:
        topics: Topics within the process, by name.
    """

    def __init__(self, topics: Mapping[str, DirectTopic]) -> None:
        self._topics = topics
        super().__init__()

    def create_publisher(self, kind: Any, topic: str, *args: Any, **options: Any) -> Any:  # noqa: ANN401
        """Create a publisher; of the topics within the process, one that serves both."""
        publisher = super().create_publisher(kind, topic, *args, **options)
        direct = self._topics.get(topic)
        return publisher if direct is None else DirectPublisher(publisher, direct)


class DirectFger(FgerNode):
    """The estimator, which takes events and frames within the process.

    They come in the driver's thread, services and transitions in the executor's: a lock keeps them
    apart, as one executor thread does where the node has a process of its own.

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
        """Subscribe; to the topics within the process, without the middleware."""
        direct = self._topics.get(topic)
        if direct is None:
            return super().create_subscription(kind, topic, callback, *args, **options)
        return direct.subscribe(self._alone(callback))

    def destroy_subscription(self, subscription: Any) -> bool:  # noqa: ANN401
        """End a subscription of either sort."""
        if not isinstance(subscription, DirectSubscription):
            return bool(super().destroy_subscription(subscription))
        for topic in self._topics.values():
            topic.unsubscribe(subscription)
        return True

    def create_service(
        self,
        kind: Any,  # noqa: ANN401
        name: str,
        callback: Callable[..., Any],
        *args: Any,  # noqa: ANN401
        **options: Any,  # noqa: ANN401
    ) -> Any:  # noqa: ANN401
        """Create a service whose calls and the messages do not meet."""
        return super().create_service(kind, name, self._alone(callback), *args, **options)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start estimating."""
        with self._lock:
            return super().on_activate(state)

    def close(self) -> None:
        """Stop estimating."""
        with self._lock:
            super().close()

    def _alone(self, callback: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(callback)
        def alone(*args: Any) -> Any:  # noqa: ANN401
            with self._lock:
                return callback(*args)

        return alone


def make_nodes() -> list[Any]:
    """Return the two nodes; call after `rclpy.init`."""
    topics = {name: DirectTopic() for name in DIRECT}
    # The estimator first: a driver that cannot open its device ends the process.
    return [DirectFger(topics), DirectDriver(topics)]


def main(args: list[str] | None = None) -> int:
    """Run driver and estimator."""
    return run_together(make_nodes, args)


if __name__ == '__main__':
    sys.exit(main())
