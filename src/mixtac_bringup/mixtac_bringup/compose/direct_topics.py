# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Messages handed from a publisher to a callback of the same process, in the publishing thread.

rclpy has no intra-process transport: also within one process a message is serialised, given to the
middleware, and picked up by an executor thread, which has to be woken and to get the interpreter's
lock. Where one thread produces and the other does nothing but wait for it, a call does the same.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from collections.abc import Callable


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
