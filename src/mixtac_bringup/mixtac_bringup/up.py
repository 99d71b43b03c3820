# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac up`: the graph of `sensor.launch.py` on machines without `ros2 launch`."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mixtac_bringup.compose.process import in_one_process
from mixtac_bringup.graph import NodeSpec, is_virtual, sensor_graph
from mixtac_bringup.monitor_node import Monitor
from mixtac_bringup.processes import ProcessGroup

if TYPE_CHECKING:
    from pathlib import Path

    from rich.console import Console


@dataclass(frozen=True)
class UpOptions:
    """What `mixtac up` was asked for.

    Attributes:
        device: What the driver opens.
        namespace: ROS namespace.
        params_file: File whose parameters win over the shipped ones.
        log_level: Severity from which nodes log.
        seconds: How long to run [s]; 0 for until interrupted.
        record: Folder of a new bag to record to.
        autostart: Configure and activate the lifecycle nodes.
        play: On the virtual sensor, play its scenario again and again once the force is there.
        view: Show it live in the browser.
        single_process: Driver and estimator in one process.
    """

    device: str = 'davis346'
    namespace: str = 'mixtac'
    params_file: Path | None = None
    log_level: str = 'info'
    seconds: float = 0.0
    record: Path | None = None
    autostart: bool = True
    play: bool = True
    view: bool = False
    single_process: bool = False


def run_graph(console: Console, options: UpOptions) -> None:
    """Run the sensor until interrupted, or for some seconds.

    Raises:
        GraphError: A node failed.
        ViewError: The live view is not installed.
    """
    play = options.play and is_virtual(options.device)
    nodes = sensor_graph(options.device, virtual_sensor={'loop': True} if play else None)
    if options.single_process:
        nodes = in_one_process(nodes)
    if options.record is not None:
        nodes.append(recorder(options.record))
    if options.view:
        from mixtac_bringup.view.command import view_node

        nodes.append(view_node())
    with ProcessGroup() as processes:
        for node in nodes:
            command = node.command(options.namespace, options.params_file, options.log_level)
            processes.start(node.name, command)
        if options.autostart:
            _activate(options.namespace, nodes, processes, play=play)
            console.print(f'sensor active in namespace /{options.namespace}; Ctrl-C ends it')
        end = time.monotonic() + options.seconds
        while not options.seconds or time.monotonic() < end:
            time.sleep(0.2)
            processes.check()


def _activate(
    namespace: str, nodes: list[NodeSpec], processes: ProcessGroup, *, play: bool
) -> None:
    with Monitor(namespace, seconds=60.0) as monitor:
        for node in nodes:
            if node.lifecycle:
                monitor.bring_up(node.name, processes)
        if play:
            # The estimator first has to see the sensor without contact.
            monitor.listen()
            monitor.wait_for_force(processes.check)
            monitor.trigger('virtual_sensor/play', processes.check)


def recorder(output: Path) -> NodeSpec:
    """Return the node that records the sensor's topics to a new bag."""
    return NodeSpec(
        'mixtac_bringup', 'recorder_node', 'recorder', overrides={'output': str(output)}
    )
