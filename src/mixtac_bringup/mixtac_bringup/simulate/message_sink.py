# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Messages on their way to a bag, put in the order in which a recorder would have had them."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterable


class BagMessage(NamedTuple):
    """One message of a bag.

    Attributes:
        received_ns: When a recorder would have had it [ns since the Unix epoch].
        topic: Name relative to the namespace, or absolute.
        data: Serialised message.
    """

    received_ns: int
    topic: str
    data: bytes


class MessageSink:
    """Sorts messages by the time of their reception; those of one time keep their order."""

    def __init__(self) -> None:
        self._waiting: list[BagMessage] = []

    def put(self, received_ns: int, topic: str, data: bytes) -> None:
        """Add a message."""
        self._waiting.append(BagMessage(received_ns, topic, data))

    def put_rows(self, received_ns: Iterable[int], topic: str, rows: Iterable[bytes]) -> None:
        """Add messages of one topic.

        Args:
            received_ns: When each was received.
            topic: Their topic.
            rows: The messages.
        """
        pairs = zip(received_ns, rows, strict=True)
        self._waiting.extend(BagMessage(when, topic, row) for when, row in pairs)

    def take(self, until_ns: int) -> list[BagMessage]:
        """Return and forget the messages received before a time [ns], in order."""
        due = [message for message in self._waiting if message.received_ns < until_ns]
        self._waiting = [message for message in self._waiting if message.received_ns >= until_ns]
        due.sort(key=lambda message: message.received_ns)
        return due
