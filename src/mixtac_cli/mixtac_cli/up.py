# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Commands that run nodes until Ctrl-C: `mixtac up`, `mixtac up slip` and `mixtac view`.

`mixtac up` runs the graph of `sensor.launch.py` on machines without `ros2 launch`. `mixtac up slip`
runs slip control on a simulated grasp and arm over real DDS. There, slip control, arm and
supervisor follow the clock of the simulation (`/clock`): a slow host slows everything down alike,
and neither the watchdogs nor the response to a disturbance depend on its speed.
"""

from __future__ import annotations

import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Optional

import typer
from rich.console import Console

from mixtac_cli.monitor_node import Monitor
from mixtac_cli.view.server import require_rerun
from mixtac_node.graph import (
    NodeSpec,
    config_file,
    executable,
    in_one_process,
    is_virtual,
    recorder,
    sensor_graph,
    yaml_value,
)
from mixtac_node.process import ProcessGroup


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


NAMESPACE = 'mixtac'
ENDED_FIRST = ('supervisor', 'slip_control', 'driver')
"""So that no node loses another that it needs."""


def slip(
    object_name: Annotated[str, typer.Option('--object', help='box, cup or ball.')] = 'box',
    disturb: Annotated[
        float, typer.Option('--disturb', help='Speed of each blow (mm/s); 0 for none.')
    ] = 50.0,
    every: Annotated[float, typer.Option(help='Time between blows (s).')] = 8.0,
    margin: Annotated[float, typer.Option(help='Grasp force over the least that holds.')] = 1.05,
    preset: Annotated[str, typer.Option(help='How hard the sensor is.')] = 'paper_like',
    seed: Annotated[int, typer.Option(help='Which sensor, day and object.')] = 1,
    plant: Annotated[
        str, typer.Option(help='What the arm is: lag, or mujoco (requirements/mujoco.txt).')
    ] = 'lag',
    seconds: Annotated[float, typer.Option(help='How long; 0 until interrupted (s).')] = 0.0,
) -> None:
    """Hold a simulated object against blows with the real driver and slip control."""
    from mixtac_node.process import ProcessGroup

    with tempfile.TemporaryDirectory(prefix='mixtac-') as folder, ProcessGroup() as processes:
        socket = str(Path(folder) / 'usb.sock')
        grasp = {
            'object': object_name,
            'knock': disturb,
            'margin': margin,
            'preset': preset,
            'device_seed': seed,
            'seed': seed,
            'socket': socket,
            'publish_clock': True,
        }
        processes.start('virtual_grasp', _simulated('virtual_grasp', **grasp))
        processes.start('virtual_arm', _simulated('virtual_arm', plant=plant, use_sim_time=True))
        processes.start('driver', _installed('driver', 'mixtac_driver', device=f'virtual:{socket}'))
        control = {
            'arm': 'fr3',
            'normal_frame': 'base',
            'normal_y': 1.0,
            'normal_z': 0.0,
            'use_sim_time': True,
        }
        processes.start(
            'slip_control', _installed('slip_control', 'mixtac_slip_control', **control)
        )
        processes.start('supervisor', _supervisor(every if disturb > 0.0 else 0.0))
        end = time.monotonic() + seconds
        try:
            while not seconds or time.monotonic() < end:
                time.sleep(0.2)
                processes.check()
        finally:
            for name in ENDED_FIRST:
                processes.stop(name)


def _simulated(name: str, **values: object) -> list[str]:
    return _command([str(executable('mixtac_sim', f'{name}_node'))], name, values)


def _installed(name: str, package: str, **values: object) -> list[str]:
    return _command([str(executable(package, f'{name}_node'))], name, values)


def _supervisor(every: float) -> list[str]:
    return [
        *(sys.executable, '-m', f'{__package__}.supervisor_node', '--ros-args'),
        *('-r', f'__ns:=/{NAMESPACE}', '-p', f'knock_every:={yaml_value(every)}'),
        *('-p', 'use_sim_time:=true'),
    ]


def _command(program: list[str], name: str, values: dict[str, object]) -> list[str]:
    given = [part for key, v in values.items() for part in ('-p', f'{key}:={yaml_value(v)}')]
    shipped = str(config_file(f'{name}.yaml'))
    arguments = ['--ros-args', '-r', f'__ns:=/{NAMESPACE}', '--params-file', shipped]
    return [*program, *arguments, *given]


OptionalPath = Optional[Path]  # noqa: UP045  (typer evaluates this under Python 3.10)


def view_node(port: int = 9090, save: Path | None = None) -> NodeSpec:
    """Return the node of the live view.

    Args:
        port: Of the page on 127.0.0.1; 0 for any free one.
        save: New .rrd file to write instead of serving a page.

    Raises:
        ViewError: rerun-sdk is not installed.
    """
    require_rerun()
    overrides: dict[str, object] = {'port': port}
    if save is not None:
        overrides['save'] = str(save)
    return NodeSpec('mixtac_cli', 'view_node', 'view', overrides=overrides)


def view(
    namespace: Annotated[str, typer.Option(help='ROS namespace of the sensor.')] = 'mixtac',
    port: Annotated[
        int, typer.Option(min=0, max=65535, help='Port of the page on 127.0.0.1; 0: any free one.')
    ] = 9090,
    save: Annotated[OptionalPath, typer.Option(help='Write to this .rrd file, no page.')] = None,
    seconds: Annotated[float, typer.Option(min=0, help='How long; 0 until Ctrl-C.')] = 0,
    params_file: Annotated[
        OptionalPath, typer.Option(exists=True, help='Parameters that win over the shipped ones.')
    ] = None,
) -> None:
    """Show a running sensor in the browser: events, frame, force, slip, rates."""
    node = view_node(port, save)
    with ProcessGroup() as processes:
        processes.start(node.name, node.command(namespace, params_file))
        where = save or 'the page whose address the node says'
        Console().print(f'showing /{namespace.strip("/")} in {where}; Ctrl-C ends it')
        end = time.monotonic() + seconds
        while not seconds or time.monotonic() < end:
            time.sleep(0.2)
            processes.check()


def up(
    context: typer.Context,
    device: Annotated[str, typer.Option(help='davis346, virtual or a recording.')] = 'davis346',
    namespace: Annotated[str, typer.Option(help='ROS namespace of all nodes.')] = 'mixtac',
    params_file: Annotated[
        OptionalPath, typer.Option(exists=True, help='Parameters that win over the shipped ones.')
    ] = None,
    log_level: Annotated[str, typer.Option(help='debug, info, warn, error or fatal.')] = 'info',
    seconds: Annotated[float, typer.Option(min=0, help='How long; 0 until Ctrl-C.')] = 0,
    record: Annotated[OptionalPath, typer.Option(help='Record to this new bag folder.')] = None,
    autostart: Annotated[bool, typer.Option(help='Configure and activate the estimator.')] = True,
    play: Annotated[
        bool, typer.Option(help='Play the scenario again and again (virtual device only).')
    ] = True,
    view: Annotated[bool, typer.Option(help='Live view in the browser; docs/viewing.md.')] = False,
    single_process: Annotated[
        bool, typer.Option(help='Driver and estimator in one process.')
    ] = False,
) -> None:
    """Run the sensor's nodes with their parameter files, as sensor.launch.py does."""
    if context.invoked_subcommand is not None:
        return
    options = UpOptions(
        device=device,
        namespace=namespace,
        params_file=params_file,
        log_level=log_level,
        seconds=seconds,
        record=record,
        autostart=autostart,
        play=play,
        view=view,
        single_process=single_process,
    )
    run_graph(Console(), options)
