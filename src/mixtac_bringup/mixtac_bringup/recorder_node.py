# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Records the sensor's topics to an MCAP bag, on machines without `ros2 bag record`."""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from mixtac_bringup.bag_writer import BagWriter
from mixtac_bringup.errors import BagError
from mixtac_bringup.message_types import message_class
from mixtac_bringup.recorder_parameters import RecorderParameters
from mixtac_bringup.topics import REFERENCE, TOPICS, Topic
from mixtac_node.base_node import declare, run
from mixtac_node.diagnostics import OK, WARN, DiagnosticsPublisher, Status


class RecorderNode(Node):  # type: ignore[misc]
    """Subscribes to every topic of the sensor, serialised, and hands the bytes to the writer."""

    def __init__(self) -> None:
        super().__init__('recorder')
        parameters = declare(self, RecorderParameters)
        if not parameters.output:
            raise BagError('parameter output is empty: name the folder of the new bag')
        self._writer = BagWriter(Path(parameters.output))
        chosen = [
            replace(each, name=parameters.reference_topic) if each.name == REFERENCE else each
            for each in TOPICS
        ]
        connections = [(each, self._announce(each)) for each in chosen]
        for each, connection in connections:
            self.create_subscription(
                message_class(each.type_name),
                each.name,
                partial(self._on_message, connection),
                _qos(each),
                raw=True,
            )
        self._diagnostics = DiagnosticsPublisher(self, 'recorder', self._status)

    def close(self) -> None:
        """Finish the bag."""
        self._writer.close()
        if self._writer.dropped:
            self.get_logger().warning(f'{self._writer.dropped} messages lost: disk too slow')

    def _announce(self, each: Topic) -> object:
        return self._writer.add_topic(
            each.resolved(self.get_namespace()),
            each.type_name,
            reliable=each.reliable,
            latched=each.latched,
        )

    def _on_message(self, connection: object, data: bytes) -> None:
        self._writer.write(connection, time.time_ns(), data)  # type: ignore[arg-type]

    def _status(self) -> Status:
        dropped = self._writer.dropped
        message = f'{dropped} messages lost: disk too slow' if dropped else 'recording'
        return Status(WARN if dropped else OK, message, {'dropped': dropped})


def _qos(each: Topic) -> QoSProfile:
    return QoSProfile(
        depth=max(1000, each.depth) if not each.latched else 1,
        reliability=ReliabilityPolicy.RELIABLE if each.reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if each.latched else DurabilityPolicy.VOLATILE,
    )


def main(args: list[str] | None = None) -> int:
    """Run the recorder node."""
    return run(RecorderNode, args)


if __name__ == '__main__':
    sys.exit(main())
