# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the live view has received: only kept here, in fixed memory, until it is drawn."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from mixtac_bringup.view.curve import Curve
from mixtac_bringup.view.packet_backlog import PacketBacklog


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
