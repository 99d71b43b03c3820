# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Event packets that wait for the next picture: bounded in number and bytes, oldest given up."""

from __future__ import annotations

import threading
from collections import deque
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mixtac_events.codec import PacketMessage

MOST_PACKETS = 400
MOST_BYTES = 2_000_000


class PacketBacklog:
    """Takes packets from the subscription, hands them to the picture.

    Attributes:
        packets: Packets received.
        skipped: Those given up because pictures were made too slowly for them.
        lost: Those that never arrived, by the gaps of their sequence number.
    """

    def __init__(self) -> None:
        self.packets = 0
        self.skipped = 0
        self.lost = 0
        self._waiting: deque[PacketMessage] = deque()
        self._bytes = 0
        self._sequence: int | None = None
        self._lock = threading.Lock()

    def add(self, message: PacketMessage, sequence: int) -> None:
        """Keep a packet; the oldest ones leave when there are too many.

        Args:
            message: The packet.
            sequence: Its field `seq`.
        """
        self.packets += 1
        if self._sequence is not None and sequence > self._sequence:
            self.lost += sequence - self._sequence - 1
        self._sequence = sequence
        with self._lock:
            self._waiting.append(message)
            self._bytes += len(message.events)
            while len(self._waiting) > MOST_PACKETS or self._bytes > MOST_BYTES:
                self._bytes -= len(self._waiting.popleft().events)
                self.skipped += 1

    def take(self) -> list[PacketMessage]:
        """Return the waiting packets, oldest first, and forget them."""
        with self._lock:
            taken = list(self._waiting)
            self._waiting.clear()
            self._bytes = 0
        return taken
