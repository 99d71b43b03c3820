# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac up`: the graph of `sensor.launch.py` on machines without `ros2 launch`."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from mixtac_bringup.graph import NodeSpec, sensor_graph
from mixtac_bringup.monitor_node import Monitor
from mixtac_bringup.processes import ProcessGroup

if TYPE_CHECKING:
    from pathlib import Path

    from rich.console import Console


def run_graph(
    console: Console,
    device: str,
    namespace: str,
    params_file: Path | None,
    log_level: str,
    seconds: float,
    record: Path | None,
    *,
    autostart: bool,
) -> None:
    """Run the sensor until interrupted, or for some seconds.

    Args:
        console: Where to report.
        device: What the driver opens.
        namespace: ROS namespace.
        params_file: File whose parameters win over the shipped ones.
        log_level: Severity from which nodes log.
        seconds: How long to run; 0 for until interrupted.
        record: Folder of a new bag to record to.
        autostart: Configure and activate the lifecycle nodes.

    Raises:
        GraphError: A node failed.
    """
    nodes = sensor_graph(device)
    if record is not None:
        nodes.append(recorder(record))
    with ProcessGroup() as processes:
        for node in nodes:
            processes.start(node.name, node.command(namespace, params_file, log_level))
        if autostart:
            with Monitor(namespace, seconds=1.0) as monitor:
                for node in nodes:
                    if node.lifecycle:
                        monitor.bring_up(node.name, processes.check)
            console.print(f'sensor active in namespace /{namespace}; Ctrl-C ends it')
        end = time.monotonic() + seconds
        while not seconds or time.monotonic() < end:
            time.sleep(0.2)
            processes.check()


def recorder(output: Path) -> NodeSpec:
    """Return the node that records the sensor's topics to a new bag."""
    return NodeSpec(
        'mixtac_bringup', 'recorder_node', 'recorder', overrides={'output': str(output)}
    )
