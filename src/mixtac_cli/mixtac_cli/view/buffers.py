# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the live view has received, kept in bounded memory until it is drawn."""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mixtac_events.sequence import SequenceCounter

if TYPE_CHECKING:
    from mixtac_events.codec import PacketMessage


Columns = tuple[NDArray[np.int64], NDArray[np.float64]]


class Curve:
    """Keeps the samples of one plotted line until they are taken.

    One thread adds, another takes.

    Args:
        capacity: Samples that are kept; when nobody takes them, further ones are counted as lost.

    Attributes:
        received: All samples so far.
        dropped: Those that found no room.
        latest: The last value, NaN before the first.
    """

    def __init__(self, capacity: int = 4000) -> None:
        self.received = 0
        self.dropped = 0
        self.latest = float('nan')
        self._time_ns = np.zeros(capacity, np.int64)
        self._value = np.zeros(capacity)
        self._count = 0
        self._lock = threading.Lock()

    def add(self, time_ns: int, value: float) -> None:
        """Keep a sample.

        Args:
            time_ns: Where it stands in the plot [ns].
            value: What is plotted.
        """
        self.received += 1
        self.latest = value
        with self._lock:
            i = self._count
            if i == len(self._value):
                self.dropped += 1
                return
            self._time_ns[i] = time_ns
            self._value[i] = value
            self._count = i + 1

    def take(self, most: int) -> Columns:
        """Return times [ns] and values since the last call, at most `most` of them.

        Of each group of neighbours the one farthest from their mean stays, so that a peak is never
        thinned away.
        """
        with self._lock:
            n = self._count
            times, values = self._time_ns[:n].copy(), self._value[:n].copy()
            self._count = 0
        return thinned(times, values, most)


def thinned(times: NDArray[np.int64], values: NDArray[np.float64], most: int) -> Columns:
    """Return at most `most` of the samples, keeping the extreme one of each group.

    Args:
        times: Times [ns].
        values: Values at these.
        most: Largest number of samples to return, at least 1.
    """
    n = len(values)
    if n <= most:
        return times, values
    starts = np.linspace(0, n, most + 1).astype(np.intp)[:-1]
    lengths = np.diff(np.append(starts, n))
    means = np.add.reduceat(values, starts) / lengths
    distance = np.abs(values - np.repeat(means, lengths))
    # Stable order by group, then by distance: the last of each group is its farthest.
    group = np.repeat(np.arange(most), lengths)
    kept = np.lexsort((distance, group))[np.append(starts[1:], n) - 1]
    return times[kept], values[kept]


MOST_PACKETS = 400
MOST_BYTES = 2_000_000


class PacketBacklog:
    """Takes packets from the subscription, hands them to the picture.

    Attributes:
        skipped: Those given up because pictures were made too slowly for them.
    """

    def __init__(self) -> None:
        self.skipped = 0
        self._counter = SequenceCounter()
        self._waiting: deque[PacketMessage] = deque()
        self._bytes = 0
        self._lock = threading.Lock()

    @property
    def packets(self) -> int:
        """Packets received."""
        return self._counter.received

    @property
    def lost(self) -> int:
        """Packets that never arrived, by the gaps of their sequence numbers."""
        return self._counter.lost

    def add(self, message: PacketMessage, sequence: int) -> None:
        """Keep a packet; the oldest ones leave when there are too many.

        Args:
            message: The packet.
            sequence: Its field `seq`.
        """
        self._counter.update(sequence)
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


@dataclass(frozen=True, slots=True)
class NodeState:
    """What a node last said of itself.

    Attributes:
        level: 0 ok, 1 warning, 2 error, 3 stale.
        message: Its line for people.
    """

    level: int
    message: str


@dataclass
class Received:
    """Filled by the subscriptions, emptied by the drawing thread.

    Attributes:
        packets: Event packets.
        force: Estimated force [N] over arrival.
        reference: Reference force [N] over arrival.
        slip_count: Events per counting window over arrival.
        slip_threshold: The count above which the object slips.
        slipping: What the slip detection said last, None while it does not run.
        frame: Latest frame, None once drawn.
        frames: Frames received.
        nodes: What the nodes say, by name.
    """

    packets: PacketBacklog = field(default_factory=PacketBacklog)
    force: Curve = field(default_factory=Curve)
    reference: Curve = field(default_factory=Curve)
    slip_count: Curve = field(default_factory=Curve)
    slip_threshold: Curve = field(default_factory=Curve)
    slipping: bool | None = None
    frame: Any = None
    frames: int = 0
    nodes: dict[str, NodeState] = field(default_factory=dict)

    def on_frame(self, message: Any) -> None:  # noqa: ANN401
        """Keep a `sensor_msgs/Image`."""
        self.frame = message
        self.frames += 1

    def on_slip(self, message: Any, arrival_ns: int) -> None:  # noqa: ANN401
        """Keep a `mixtac_msgs/SlipState`."""
        self.slip_count.add(arrival_ns, float(message.count))
        self.slip_threshold.add(arrival_ns, float(message.threshold))
        self.slipping = bool(message.slipping)

    def on_diagnostics(self, message: Any) -> None:  # noqa: ANN401
        """Keep a `diagnostic_msgs/DiagnosticArray`."""
        for status in message.status:
            level = status.level[0] if isinstance(status.level, bytes) else int(status.level)
            # A new dictionary: the drawing thread walks through the old one.
            self.nodes = {**self.nodes, status.name: NodeState(level, status.message)}
