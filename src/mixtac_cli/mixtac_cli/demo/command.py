# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac demo`: the whole path from the virtual camera to the force, shown live and measured."""

from __future__ import annotations

import datetime as dt
import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from mixtac_cli.calibrate_force.session import LiveProcedure
from mixtac_cli.demo.evaluation import WINDOW_NS
from mixtac_cli.demo.live_table import PERIOD_S, LiveTable
from mixtac_cli.demo.report import BAG, PRESET, Run, evaluate, print_summary
from mixtac_cli.monitor_node import Monitor
from mixtac_cli.options import JsonFile, OptionalPath
from mixtac_cli.up import start_nodes
from mixtac_fger.force_calibration import ForceCalibrationError, fit_gain, load_of
from mixtac_node.files import FileError, write_json
from mixtac_node.graph import recorder, sensor_graph
from mixtac_node.process import GraphError, ProcessGroup
from mixtac_node.topics import CONTACT, CONTACT_POINT, DEFAULT_NAMESPACE, Topic

SETTLE_S = 1.0
LEAD_S = 8.0
"""Delay of the scenario after time goes on again."""
CLOCK_S = 5.0
"""Time in which the driver finds out that the camera's clock stood still."""
START_UP_S = 60.0
TAIL_S = 1.0
LOADS_G = (30.0, 60.0, 90.0)
"""Known loads by which the demo calibrates the sensor [g]."""
DROP_COUNTERS = {
    'driver': (
        'usb transfers dropped',
        'bytes dropped',
        'frames dropped',
        'imu dropped',
        'external edges dropped',
        'camera dropped',
        'camera dvs dropped',
        'camera external input dropped',
    ),
    'fger': ('frames_dropped',),
    'recorder': ('messages dropped',),
}
"""Diagnostics of each node that count what it received and did not pass on."""


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
    now = dt.datetime.now().astimezone()
    folder = out or Path('demo_out') / f'{now:%Y%m%d-%H%M%S}'
    _private_domain(console)
    try:
        folder.mkdir(parents=True)
    except OSError as error:
        raise FileError(
            f'cannot create folder {folder}: {error.strerror}', remedy='name a new folder in --out'
        ) from error
    run, failed = _run_graph(console, folder, seconds, seed, device_seed, model)
    console.print('aligning and comparing')
    report = evaluate(folder, run, seconds, seed, device_seed)
    for path in (folder / 'demo.json', json):
        write_json(path, report)
    print_summary(console, report, folder)
    if failed:
        raise GraphError(f'nodes did not end cleanly: {failed}', remedy=f'see {folder / "log"}')


def _private_domain(console: Console) -> None:
    """Keep the demo apart from other ROS graphs on this machine."""
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    os.environ.setdefault('ROS_DOMAIN_ID', str(1 + os.getpid() % 100))
    console.print(f'ROS_DOMAIN_ID={os.environ["ROS_DOMAIN_ID"]} (for tools in another terminal)')


def _run_graph(
    console: Console, out: Path, seconds: float, seed: int, device_seed: int, model: Path | None
) -> tuple[Run, dict[str, int]]:
    """Run the graph through the scenario, recorded to the folder `bag`.

    Returns:
        What was measured, and the exit status of nodes that did not end cleanly.
    """
    virtual_sensor = {
        'seed': seed,
        'device_seed': device_seed,
        'preset': PRESET,
        'scenario': 'demo',
        'seconds': float(seconds),
        'play_on_start': False,
        'loop': False,
        'lead_seconds': LEAD_S,
        'slow_host': 'wait',
    }
    # A blow saturates the sensor for an instant, and its peak is to be seen.
    estimator = {'invalid_force': 'publish'}
    if model is not None:
        estimator['model'] = str(model.resolve())
    # Less for a slow host to do: packets as long as a window, and no inertial samples.
    driver = {
        'event_message_time_threshold': WINDOW_NS / 1e9,
        'imu_acc_enabled': False,
        'imu_gyro_enabled': False,
        'imu_temp_enabled': False,
        # While the host computes, the camera sends nothing.
        'stream_timeout': 600.0,
    }
    sensor = sensor_graph(
        'virtual', driver=driver, virtual_sensor=virtual_sensor, estimator=estimator
    )
    console.print('starting virtual sensor, driver and estimator')
    with (
        ProcessGroup(out / 'log') as processes,
        Monitor(DEFAULT_NAMESPACE, seconds + START_UP_S) as monitor,
    ):
        start_nodes(processes, sensor)
        monitor.bring_up_all(sensor, processes)
        monitor.listen()
        monitor.wait_for_force(processes.check)
        gain = _calibrate(console, processes, monitor)
        _record(out / BAG, processes, monitor, exclude=(CONTACT, CONTACT_POINT))
        # Messages in the first half second after discovery are often lost.
        time.sleep(SETTLE_S)
        lost_s = _lost_s(monitor)
        _compute_scenario(console, processes, monitor)
        time.sleep(CLOCK_S)
        computed_s = _lost_s(monitor) - lost_s
        first, pairs = monitor.force_count, len(monitor.clock_pairs())
        LiveTable(console, monitor).show(LEAD_S - CLOCK_S + seconds + TAIL_S, processes.check)
        arrival, stamp, _ = monitor.force()
        waited_s = _lost_s(monitor) - lost_s - computed_s
        run = Run(
            gain=gain,
            dropped=_dropped(monitor),
            computed_s=computed_s,
            waited_s=waited_s,
            clock_pairs=monitor.clock_pairs()[pairs:],
            arrival_ns=arrival[first:],
            stamp_ns=stamp[first:],
        )
        codes = (processes.stop('recorder'), processes.stop())
        failed = {name: code for each in codes for name, code in each.items() if code}
    return run, failed


def _record(
    bag: Path, processes: ProcessGroup, monitor: Monitor, exclude: Sequence[Topic] = ()
) -> None:
    """Start to record to a new bag; return when that has begun."""
    monitor.diagnostics.pop(f'{DEFAULT_NAMESPACE}/recorder', None)
    start_nodes(processes, [recorder(bag, exclude=exclude)])
    while not monitor.values('recorder'):
        time.sleep(0.1)
        processes.check()


def _calibrate(console: Console, processes: ProcessGroup, monitor: Monitor) -> float:
    """Calibrate as `mixtac calibrate-force` does; return the gain, 1 if that is refused."""
    console.print('calibrating by known loads, as mixtac calibrate-force does')
    procedure = LiveProcedure(console, processes, monitor, virtual=True)
    loads = [load_of(grams, 0.0) for grams in LOADS_G]
    try:
        session = procedure.lead(loads)
        calibration = fit_gain(session.loads, session.plateaus)
    except ForceCalibrationError as error:
        # As on a host that is too busy; what follows is worth showing all the same.
        console.print(f'not calibrated: {error}', soft_wrap=True)
        monitor.trigger('virtual_sensor/release', processes.check)
        return 1.0
    monitor.set_parameters('fger', {'force_scale': calibration.gain}, processes.check)
    console.print(f'gain {calibration.gain:.3f}', highlight=False)
    return calibration.gain


def _compute_scenario(console: Console, processes: ProcessGroup, monitor: Monitor) -> None:
    """Start the scenario; return when it is computed."""
    monitor.trigger('virtual_sensor/play', processes.check)
    while int(monitor.values('virtual_sensor').get('plays', 0)) < 1:
        time.sleep(0.1)
        processes.check()
    with console.status('computing the scenario') as status:
        while (values := monitor.values('virtual_sensor')).get('computing') == 'True':
            done_s = float(values['ahead_us']) / 1e6
            status.update(f'computing the scenario: {done_s:.0f} s are ready')
            time.sleep(PERIOD_S)
            processes.check()


def _lost_s(monitor: Monitor) -> float:
    """Return for how long simulated time has stopped so far [s]."""
    return float(monitor.values('virtual_sensor').get('lost_us', 0)) / 1e6


def _dropped(monitor: Monitor) -> int:
    return sum(
        int(float(monitor.values(node).get(key, 0)))
        for node, keys in DROP_COUNTERS.items()
        for key in keys
    )
