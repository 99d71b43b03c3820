# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac demo`: the whole path from the virtual camera to the force, shown live and measured."""

from __future__ import annotations

import datetime as dt
import os
import time
from pathlib import Path
from typing import Annotated, Final

import typer
from rich.console import Console

from mixtac.demo.report import BAG, WINDOW_NS, Run, evaluate, print_summary
from mixtac.live_table import LiveTable
from mixtac.monitor_node import Monitor
from mixtac.options import JsonFile, OptionalPath
from mixtac.up import start_nodes
from mixtac_core.node.files import FileError, write_json
from mixtac_core.node.graph import recorder, sensor_graph
from mixtac_core.node.process import GraphError, ProcessGroup
from mixtac_core.node.topics import CONTACT, CONTACT_POINT, DEFAULT_NAMESPACE

PRESET: Final = 'paper_like'
"""What the shipped model was trained for."""
LEAD_S: Final = 8.0
"""Delay of the scenario after time goes on again [s]."""
TAIL_S: Final = 1.0
"""Time in which what was simulated last reaches the recorder [s]."""
START_S: Final = 120.0
"""Longest time of the sensor before the scenario for which forces are kept [s]."""


def demo(
    seconds: Annotated[
        float, typer.Option(min=12, max=3600, help='Length of the scenario (s).')
    ] = 30,
    seed: Annotated[
        int, typer.Option(min=0, help='Random seed for forces, contact point, noise and clocks.')
    ] = 1001,
    device_seed: Annotated[
        int,
        typer.Option(
            min=0,
            max=9_999_999,
            help='Random seed that selects the virtual sensor (beads, gel, lamp, pixels).',
        ),
    ] = 1001,
    model: Annotated[
        OptionalPath, typer.Option(help='Weight file to use instead of the shipped one.')
    ] = None,
    json: JsonFile = None,
    out: Annotated[
        OptionalPath, typer.Option(help='New folder for the bag, the figure and the logs.')
    ] = None,
) -> None:
    """Run the graph on the virtual sensor, show it live, then measure and draw the run."""
    console = Console(markup=False)
    folder = out or Path('demo_out') / f'{dt.datetime.now().astimezone():%Y%m%d-%H%M%S}'
    # Apart from other ROS graphs on this machine.
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    domain = os.environ.setdefault('ROS_DOMAIN_ID', str(1 + os.getpid() % 100))
    console.print(f'ROS_DOMAIN_ID={domain} (for tools in another terminal)')
    try:
        folder.mkdir(parents=True)
    except OSError as error:
        raise FileError(
            f'cannot create folder {folder}: {error.strerror}', remedy='name a new folder in --out'
        ) from error
    with ProcessGroup(folder / 'log') as processes:
        run = _run_graph(console, processes, folder / BAG, seconds, seed, device_seed, model)
        codes = {**processes.stop('recorder'), **processes.stop()}
    console.print('aligning and comparing')
    report = evaluate(folder, run, seconds, seed, device_seed)
    for path in (folder / 'demo.json', json):
        write_json(path, report)
    print_summary(console, report, folder)
    if failed := {name: code for name, code in codes.items() if code}:
        raise GraphError(f'nodes did not end cleanly: {failed}', remedy=f'see {folder / "log"}')


def _run_graph(
    console: Console,
    processes: ProcessGroup,
    bag: Path,
    seconds: float,
    seed: int,
    device_seed: int,
    model: Path | None,
) -> Run:
    """Run the graph through the scenario, record it, and return what was measured live."""
    virtual_sensor = {
        'seed': seed,
        'device_seed': device_seed,
        'preset': PRESET,
        'scenario': 'demo',
        'seconds': float(seconds),
        'play_on_start': False,
        'loop': False,
        'lead_seconds': LEAD_S,
    }
    # An impact saturates the sensor for an instant, and its peak is to be seen.
    estimator = {'invalid_force': 'publish'}
    if model is not None:
        estimator['model'] = str(model.resolve())
    # Less work for a slow host: packets as long as a window, and no inertial samples.
    driver = {
        'event_message_time_threshold': WINDOW_NS / 1e9,
        'imu_acc_enabled': False,
        'imu_gyro_enabled': False,
        'imu_temp_enabled': False,
        # While the host is behind, the camera sends nothing.
        'stream_timeout': 600.0,
    }
    nodes = sensor_graph(
        'virtual', driver=driver, virtual_sensor=virtual_sensor, estimator=estimator
    )
    nodes.append(recorder(bag, exclude=(CONTACT, CONTACT_POINT)))
    console.print('starting virtual sensor, driver, estimator and recorder')
    with Monitor(DEFAULT_NAMESPACE, seconds + START_S) as monitor:
        start_nodes(processes, nodes)
        monitor.bring_up_all(nodes, processes)
        monitor.listen()
        monitor.wait_for_force(processes.check)
        return _play(LiveTable(console, monitor), processes, monitor, seconds)


def _play(table: LiveTable, processes: ProcessGroup, monitor: Monitor, seconds: float) -> Run:
    """Play the scenario while the table shows it; return what was measured."""

    def sensor() -> dict[str, str]:
        processes.check()
        return monitor.values('virtual_sensor')

    def lost_s() -> float:
        return float(sensor().get('lost_us', 0)) / 1e6

    def starting() -> str:
        return 'the scenario starts' if sensor().get('plays', '0') == '0' else ''

    def playing() -> str:
        return 'playing the scenario' if sensor()['playing'] == 'True' else ''

    table.show(lambda: '' if sensor() and monitor.values('recorder') else 'the recorder starts')
    started_s = lost_s()
    monitor.trigger('virtual_sensor/play', processes.check)
    table.show(starting)
    computed_s = lost_s() - started_s
    table.show(playing)
    time.sleep(TAIL_S)
    arrival, stamp = monitor.estimate.times_ns
    played = stamp > stamp[-1] - round(1e9 * (seconds + TAIL_S))
    return Run(
        dropped=sum(
            int(float(value))
            for node in ('driver', 'fger', 'recorder')
            for key, value in monitor.values(node).items()
            if key.endswith('dropped')
        ),
        computed_s=computed_s,
        waited_s=lost_s() - started_s - computed_s,
        arrival_ns=arrival[played],
        stamp_ns=stamp[played],
    )
