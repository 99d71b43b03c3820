# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Stand-in for the ROS package of this name, which has no wheel: what Mixtac uses of it.

Names, arguments and behaviour are those of the released package, which is used where it is
installed.
"""

from __future__ import annotations

import itertools
from threading import Lock
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rclpy.node import Node

NS_PER_S = 1_000_000_000


class SimpleFilter:
    """Passes messages to callbacks.

    Attributes:
        callbacks: Callback and additional arguments by connection number.
    """

    def __init__(self) -> None:
        self.callbacks: dict[int, tuple[Callable[..., None], tuple[Any, ...]]] = {}

    def registerCallback(self, cb: Callable[..., None], *args: Any) -> int:  # noqa: N802, ANN401
        """Call `cb` with each output, followed by `args`; return the connection number."""
        number = len(self.callbacks)
        self.callbacks[number] = (cb, args)
        return number

    def signalMessage(self, *msg: Any) -> None:  # noqa: N802, ANN401
        """Call all callbacks."""
        for callback, args in self.callbacks.values():
            callback(*msg, *args)


class Subscriber(SimpleFilter):
    """Passes on the messages of a topic.

    Args:
        node: Node that subscribes.
        msg_type: Type of the messages.
        topic: Name of the topic.
        qos_profile: Quality of service, or the depth of the queue.
        options: Further arguments of `Node.create_subscription`.

    Attributes:
        sub: The subscription.
    """

    def __init__(
        self,
        node: Node,
        msg_type: type,
        topic: str,
        qos_profile: Any = 10,  # noqa: ANN401
        **options: Any,  # noqa: ANN401
    ) -> None:
        super().__init__()
        self.sub = node.create_subscription(
            msg_type, topic, self.signalMessage, qos_profile=qos_profile, **options
        )


class TimeSynchronizer(SimpleFilter):
    """Passes on one message of each input, all with the same stamp.

    A set that is complete leaves the queues. Where a queue overflows, its oldest message goes.

    Args:
        fs: The inputs.
        queue_size: Most messages that wait, per input.

    Attributes:
        queues: Waiting messages by stamp [ns], per input.
    """

    def __init__(self, fs: Sequence[SimpleFilter], queue_size: int) -> None:
        super().__init__()
        self.queue_size = queue_size
        self.queues: list[dict[int, Any]] = [{} for _ in fs]
        self.lock = Lock()
        for index, (each, queue) in enumerate(zip(fs, self.queues, strict=True)):
            each.registerCallback(self.add, queue, index)

    def add(self, msg: Any, my_queue: dict[int, Any], my_queue_index: int) -> None:  # noqa: ANN401
        """Add a message of an input."""
        with self.lock:
            stamp = self._keep(msg, my_queue)
            self._match(stamp, my_queue_index)

    def _keep(self, msg: Any, queue: dict[int, Any]) -> int:  # noqa: ANN401
        stamp: int = msg.header.stamp.sec * NS_PER_S + msg.header.stamp.nanosec
        queue[stamp] = msg
        while len(queue) > self.queue_size:
            del queue[min(queue)]
        return stamp

    def _match(self, _stamp: int, _index: int) -> None:
        for stamp in sorted(set(self.queues[0]).intersection(*self.queues[1:])):
            self._pass_on([stamp] * len(self.queues))

    def _pass_on(self, stamps: Sequence[int]) -> None:
        pairs = list(zip(self.queues, stamps, strict=True))
        self.signalMessage(*(queue[stamp] for queue, stamp in pairs))
        for queue, stamp in pairs:
            del queue[stamp]


class ApproximateTimeSynchronizer(TimeSynchronizer):
    """Passes on one message of each input, whose stamps differ by less than a limit.

    Each new message is matched with the nearest of the other inputs.

    Args:
        fs: The inputs.
        queue_size: Most messages that wait, per input.
        slop: The limit [s].
    """

    def __init__(self, fs: Sequence[SimpleFilter], queue_size: int, slop: float) -> None:
        super().__init__(fs, queue_size)
        self._slop_ns = int(slop * NS_PER_S)

    def _match(self, stamp: int, index: int) -> None:
        def distance(other: int) -> int:
            return abs(other - stamp)

        near = ([s for s in queue if distance(s) <= self._slop_ns] for queue in self.queues)
        choices = [sorted(stamps, key=distance) for stamps in near]
        choices[index] = [stamp] if stamp in self.queues[index] else []
        for stamps in itertools.product(*choices):
            if max(stamps) - min(stamps) < self._slop_ns:
                self._pass_on(stamps)
                return
