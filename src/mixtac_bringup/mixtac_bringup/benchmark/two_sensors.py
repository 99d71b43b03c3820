# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac bench two-sensors`: two virtual sensors with two estimators at once."""

from __future__ import annotations

import contextlib
import json as json_format
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Annotated, Any, Optional

import typer
from rich.console import Console
from rich.table import Table

from mixtac_bringup.benchmark.compose_runs import START_TIMEOUT_S
from mixtac_bringup.benchmark.json_process import JsonProcess
from mixtac_bringup.compose.process import in_one_process
from mixtac_bringup.graph import sensor_graph

OptionalPath = Optional[Path]  # noqa: UP045  (typer evaluates this under Python 3.10)
SIDES = {'left': 5, 'right': 6}
"""Namespaces, and the seeds of their virtual sensors, from which serial numbers follow."""
SETTLE_S = 5.0


def two_sensors(
    seconds: Annotated[float, typer.Option(min=2, help='Length of the measurement (s).')] = 20,
    single_process: Annotated[bool, typer.Option(help='Driver and estimator together.')] = False,
    json: Annotated[OptionalPath, typer.Option(help='Write the figures there as well.')] = None,
) -> None:
    """Measure rates, ages and CPU of two virtual sensors with two estimators at once."""
    console = Console()
    with console.status('measuring'):
        report = run_two(seconds, together=single_process)
    console.print(_table(report))
    if json is not None:
        json.write_text(json_format.dumps(report, indent=2) + '\n')


def run_two(seconds: float, *, together: bool) -> dict[str, Any]:
    """Run both sensors and return their figures for JSON.

    Args:
        seconds: Length of the measurement [s].
        together: Run each driver and its estimator in one process.

    Raises:
        GraphError: A process did not start.
    """
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix='mixtac-')))
        env = {**os.environ, 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}
        parts: dict[tuple[str, str], JsonProcess] = {}
        probes = {}
        for side, seed in SIDES.items():
            # At rest: contacts of two sensors would not fall together from run to run.
            virtual = {
                'device_seed': seed,
                'scenario': 'idle',
                'reference_topic': f'/{side}/ft_sensor/wrench',
            }
            graph = sensor_graph(f'virtual:{folder}/{side}.sock', virtual_sensor=virtual)
            for node in in_one_process(graph) if together else graph:
                command = node.command(side, log_level='warn')
                process = JsonProcess(f'{side}/{node.name}', command, env)
                parts[side, node.name] = stack.enter_context(process)
            command = [sys.executable, '-m', 'mixtac_bringup.benchmark.force_probe_node']
            probes[side] = stack.enter_context(JsonProcess(f'{side}/probe', command, env))
        _measure_from_now(probes)
        before = {name: process.cpu_s() for name, process in parts.items()}
        began_s = time.monotonic()
        time.sleep(seconds)
        elapsed_s = time.monotonic() - began_s
        cpu = {name: (p.cpu_s() - before[name]) / elapsed_s for name, p in parts.items()}
        report: dict[str, Any] = {
            'simulated': True,
            'single_process': together,
            'seconds': elapsed_s,
            'cpu_count': os.cpu_count(),
            'cpu_total': sum(cpu.values()),
        }
        for side, probe in probes.items():
            probe.stop()
            own = {node: value for (where, node), value in cpu.items() if where == side}
            report[side] = {**probe.expect('forces', START_TIMEOUT_S), 'cpu': own}
    return report


def _measure_from_now(probes: dict[str, JsonProcess]) -> None:
    for side, probe in probes.items():
        probe.expect('ready', START_TIMEOUT_S)
        probe.send(namespace=side, settle_s=SETTLE_S)
    for probe in probes.values():
        probe.expect('active', START_TIMEOUT_S)
        probe.send(pattern=None)
    for probe in probes.values():
        probe.expect('measuring', START_TIMEOUT_S)


def _table(report: dict[str, Any]) -> Table:
    title = (
        f'Two virtual sensors, {report["cpu_count"]} cores, {100 * report["cpu_total"]:.0f} % CPU'
    )
    table = Table(title=title, title_justify='left')
    for heading in ('sensor', 'Hz', 'windows missing', 'age p50 ms', 'p99 ms', 'CPU'):
        table.add_column(heading, justify='left' if heading == 'sensor' else 'right')
    for side in SIDES:
        each = report[side]
        if not each['forces']:
            table.add_row(side, 'no force')
            continue
        table.add_row(
            side,
            f'{each["force_rate_hz"]:.1f}',
            str(each['windows_missing']),
            f'{each["force_age_p50_ms"]:.2f}',
            f'{each["force_age_p99_ms"]:.2f}',
            ', '.join(f'{name} {100 * value:.0f} %' for name, value in each['cpu'].items()),
        )
    return table
