# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Starts and ends of `sensor.launch.py` on the virtual sensor: how long they take, what they leave.

A start is clean if a force came, the launch ended with status 0 after SIGINT, nothing in its output
was an error or a traceback, and none of its processes outlived it. Needs `ros2 launch`.
"""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import psutil
import typer
from rich.console import Console
from rich.progress import track

from mixtac_cli.figures import make_table
from mixtac_cli.monitor_node import Monitor
from mixtac_cli.options import JsonFile
from mixtac_lab.bench.harness import START_TIMEOUT_S, quantiles
from mixtac_node.files import write_json
from mixtac_node.process import GraphError

NAMESPACE = 'mixtac_starts'
END_TIMEOUT_S = 60.0
POLL_S = 0.005
FAULT = re.compile(r'\[(ERROR|FATAL)\]|Traceback')
TIMES = ('force_s', 'end_s')
"""From the start to the first force, from SIGINT to the end of the launch [s]."""


def starts(
    count: Annotated[int, typer.Option(min=1, help='Number of starts.')] = 50,
    single_process: Annotated[
        bool, typer.Option(help='Run driver and estimator in one process.')
    ] = False,
    json: JsonFile = None,
) -> None:
    """Start the virtual sensor by its launch file and end it by SIGINT, many times."""
    if shutil.which('ros2') is None:
        raise GraphError('ros2 is not installed', remedy='source a ROS 2 installation')
    console = Console(markup=False)
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    with (
        tempfile.TemporaryDirectory(prefix='mixtac-') as folder,
        Monitor(NAMESPACE, 60.0 * count) as monitor,
    ):
        command = ['ros2', 'launch', 'mixtac_bringup', 'sensor.launch.py']
        command += [f'device:=virtual:{folder}/usb.sock', f'namespace:={NAMESPACE}']
        command += [
            f'reference_topic:=/{NAMESPACE}/ft',
            f'single_process:={single_process}'.lower(),
        ]
        monitor.listen()
        output = Path(folder) / 'output.txt'
        runs = [
            start_and_end(command, monitor, output)
            for _ in track(range(count), 'starting', console=console, transient=True)
        ]
    report = {'simulated': True, 'single_process': single_process, **summarise(runs)}
    console.print(
        make_table(
            f'{report["clean"]} of {report["count"]} starts and ends clean',
            ('', 'p50 s', 'p95 s'),
            [(name, *(f'{report[name][q]:.2f}' for q in ('p50', 'p95'))) for name in TIMES],
        )
    )
    for run in runs:
        for line in run['faults']:
            console.print(line)
    write_json(json, report)
    if report['clean'] < report['count']:
        raise typer.Exit(1)


def start_and_end(command: Sequence[str], monitor: Monitor, output: Path) -> dict[str, Any]:
    """Start a launch, wait for its first force, end it.

    Args:
        command: The command line.
        monitor: Listens to the force.
        output: File for what the launch prints.

    Returns:
        The times of `TIMES`, `status` of the launch, `faults` lines of its output, number of
        processes that outlived it (`orphans`), and whether it was `clean`.

    Raises:
        GraphError: No force came, or the launch did not end.
    """
    nodes: list[psutil.Process] = []
    # In the background of a shell SIGINT is ignored, and would be in the launch.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    before, began_s = monitor.force_count, time.monotonic()
    with output.open('w') as sink:
        launch = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=sink, stderr=subprocess.STDOUT
        )
    try:
        while monitor.force_count == before:
            if launch.poll() is not None or time.monotonic() - began_s > START_TIMEOUT_S:
                raise GraphError(f'no force came: {output.read_text()[-500:]}')
            time.sleep(POLL_S)
        force_s = time.monotonic() - began_s
        nodes = _nodes_of(launch)
        stopped_s = time.monotonic()
        launch.send_signal(signal.SIGINT)
        status = launch.wait(END_TIMEOUT_S)
        end_s = time.monotonic() - stopped_s
    except subprocess.TimeoutExpired as error:
        raise GraphError(f'the launch did not end within {END_TIMEOUT_S:g} s') from error
    finally:
        nodes = nodes or _nodes_of(launch)
        launch.kill()
        orphans = [each for each in nodes if each.is_running()]
        for each in orphans:
            with contextlib.suppress(psutil.Error):
                each.kill()
    faults = [line for line in output.read_text().splitlines() if FAULT.search(line)]
    clean = not (status or orphans or faults)
    return {
        **dict(zip(TIMES, (force_s, end_s), strict=True)),
        'status': status,
        'faults': faults,
        'orphans': len(orphans),
        'clean': clean,
    }


def _nodes_of(launch: subprocess.Popen[bytes]) -> list[psutil.Process]:
    try:
        nodes: list[psutil.Process] = psutil.Process(launch.pid).children(recursive=True)
    except psutil.NoSuchProcess:
        return []
    return nodes


def summarise(runs: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return `count`, `clean`, quantiles of the times, and the runs, for JSON."""
    times = {name: quantiles([run[name] for run in runs], (0.5, 0.95)) for name in TIMES}
    clean = sum(run['clean'] for run in runs)
    return {'count': len(runs), 'clean': clean, **times, 'runs': list(runs)}
