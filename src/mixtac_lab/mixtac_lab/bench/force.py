# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Age of the force at a subscriber, rates and CPU time.

`compose` compares driver and estimator in separate processes with both in one process;
`two_sensors` runs two virtual sensors with two estimators at once.
"""

from __future__ import annotations

import contextlib
import json as json_format
import os
import sys
import tempfile
import time
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from mixtac_lab.bench.harness import cpu_s
from mixtac_lab.bench.pipeline import Load, camera_command
from mixtac_node.graph import sensor_graph
from mixtac_node.process import GraphError, JsonProcess

if TYPE_CHECKING:
    from collections.abc import Mapping


NAMESPACE = 'mixtac_bench'
START_TIMEOUT_S = 120.0
SETTLE_S = 3.0


@dataclass(frozen=True, slots=True)
class ForceRun:
    """One run.

    Attributes:
        together: Whether driver and estimator shared a process.
        figures: See `mixtac_lab.bench.programs.force_probe_node.force_figures`.
        cpu: CPU time over time by process.
    """

    together: bool
    figures: Mapping[str, float]
    cpu: Mapping[str, float]

    def as_dict(self) -> dict[str, Any]:
        """Return the run for JSON."""
        return {
            'single_process': self.together,
            **self.figures,
            'cpu': dict(self.cpu),
            'cpu_total': sum(self.cpu.values()),
        }


def run_force(load: Load, seconds: float, *, together: bool) -> ForceRun:
    """Run camera, driver, estimator and subscriber, and measure.

    Args:
        load: What the simulated camera sends; it needs frames.
        seconds: Length of the measurement [s].
        together: Run driver and estimator in one process.

    Raises:
        GraphError: A process did not start, or no force came.
    """
    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix='mixtac-'))
        env = {**os.environ, 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}
        socket = str(Path(folder) / 'usb.sock')
        camera = stack.enter_context(JsonProcess('camera', camera_command(load, socket), env))
        pattern = camera.expect('ready', START_TIMEOUT_S)
        module = 'mixtac_lab.bench.programs.force_probe_node'
        probe = stack.enter_context(JsonProcess('subscriber', [sys.executable, '-m', module], env))
        probe.expect('ready', START_TIMEOUT_S)
        graph = sensor_graph(f'virtual:{socket}', single_process=together)
        nodes = [node for node in graph if node.name != 'virtual_sensor']
        parts = {
            node.name: stack.enter_context(
                JsonProcess(node.name, node.command(NAMESPACE, log_level='warn'), env)
            )
            for node in nodes
        }
        first = camera.expect('origin_ns', START_TIMEOUT_S)
        probe.send(namespace=NAMESPACE, settle_s=SETTLE_S)
        probe.expect('active', START_TIMEOUT_S)
        origin_ns = camera.latest('origin_ns', first)['origin_ns']
        values = {'period_us': pattern['period_us'], 'events': pattern['events']}
        probe.send(pattern={'origin_ns': origin_ns, **values})
        probe.expect('measuring', START_TIMEOUT_S)
        before = {name: cpu_s(process) for name, process in parts.items()}
        began_s = time.monotonic()
        time.sleep(seconds)
        elapsed_s = time.monotonic() - began_s
        cpu = {name: (cpu_s(p) - before[name]) / elapsed_s for name, p in parts.items()}
        probe.stop()
        figures = probe.expect('forces', START_TIMEOUT_S)
    if not figures['forces']:
        raise GraphError('no force came: run `mixtac up --device virtual` and read /diagnostics')
    return ForceRun(together, figures, cpu)


OptionalPath = Optional[Path]  # noqa: UP045  (typer evaluates this under Python 3.10)
FRAME_INTERVAL_US = 25_000
READING_INTERVAL_US = 1000
AGES = ('force_age_p50_ms', 'force_age_p99_ms', 'force_age_max_ms')


class Kind(Enum):
    """How driver and estimator run."""

    SEPARATE = 'separate'
    ONE = 'one'


def compose(
    seconds: Annotated[float, typer.Option(min=2, help='Length of each run (s).')] = 20,
    repeats: Annotated[int, typer.Option(min=1, help='Runs of each kind, alternating.')] = 3,
    rate: Annotated[float, typer.Option(min=1000, help='Events per second.')] = 1e6,
    only: Annotated[
        Optional[Kind],  # noqa: UP045  (typer evaluates this under Python 3.10)
        typer.Option(help='One kind of run only, for a long measurement.'),
    ] = None,
    json: Annotated[OptionalPath, typer.Option(help='Write the figures there as well.')] = None,
) -> None:
    """Measure how old the force is at a subscriber, from separate processes and from one."""
    load = Load(rate, frame_interval_us=FRAME_INTERVAL_US, reading_interval_us=READING_INTERVAL_US)
    console = Console()
    runs = []
    kinds = [only] if only is not None else list(Kind)
    with console.status('measuring'):
        for _ in range(repeats):
            runs += [run_force(load, seconds, together=kind is Kind.ONE) for kind in kinds]
    console.print(_runs_table(runs))
    if json is not None:
        json.write_text(json_format.dumps(report(runs, rate), indent=2) + '\n')


def report(runs: list[ForceRun], rate: float) -> dict[str, Any]:
    """Return medians of each kind and all runs for JSON."""
    summary: dict[str, Any] = {}
    for name, together in (('separate', False), ('single_process', True)):
        kind = [run.as_dict() for run in runs if run.together == together]
        if not kind:
            continue
        keys = (*AGES, 'force_rate_hz', 'cpu_total')
        summary[name] = {key: float(np.median([run[key] for run in kind])) for key in keys}
        summary[name]['windows_missing'] = sum(run['windows_missing'] for run in kind)
    return {
        'simulated_camera': True,
        'events_per_s': rate,
        **summary,
        'runs': [run.as_dict() for run in runs],
    }


def _runs_table(runs: list[ForceRun]) -> Table:
    table = Table(
        title='Age of the force at a subscriber: arrival less the end of its window '
        '(simulated camera)',
        title_justify='left',
    )
    headings = ('processes', 'p50 ms', 'p99 ms', 'max ms', 'Hz', 'windows missing', 'CPU')
    for heading in headings:
        table.add_column(heading, justify='left' if heading == 'processes' else 'right')
    for run in sorted(runs, key=lambda each: each.together):
        figures = run.figures
        table.add_row(
            'one' if run.together else 'separate',
            *(f'{figures[key]:.2f}' for key in AGES),
            f'{figures["force_rate_hz"]:.1f}',
            f'{figures["windows_missing"]:.0f}',
            f'{100 * sum(run.cpu.values()):.0f} %',
        )
    return table


SIDES = {'left': 5, 'right': 6}
"""Namespaces, and the seeds of their virtual sensors, from which serial numbers follow."""
TWO_SENSORS_SETTLE_S = 5.0


def two_sensors(
    seconds: Annotated[float, typer.Option(min=2, help='Length of the measurement (s).')] = 20,
    single_process: Annotated[bool, typer.Option(help='Driver and estimator together.')] = False,
    json: Annotated[OptionalPath, typer.Option(help='Write the figures there as well.')] = None,
) -> None:
    """Measure rates, ages and CPU of two virtual sensors with two estimators at once."""
    console = Console()
    with console.status('measuring'):
        report = run_two(seconds, together=single_process)
    console.print(_sensors_table(report))
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
            graph = sensor_graph(
                f'virtual:{folder}/{side}.sock', virtual_sensor=virtual, single_process=together
            )
            for node in graph:
                command = node.command(side, log_level='warn')
                process = JsonProcess(f'{side}/{node.name}', command, env)
                parts[side, node.name] = stack.enter_context(process)
            command = [sys.executable, '-m', 'mixtac_lab.bench.programs.force_probe_node']
            probes[side] = stack.enter_context(JsonProcess(f'{side}/probe', command, env))
        _measure_from_now(probes)
        before = {name: cpu_s(process) for name, process in parts.items()}
        began_s = time.monotonic()
        time.sleep(seconds)
        elapsed_s = time.monotonic() - began_s
        cpu = {name: (cpu_s(p) - before[name]) / elapsed_s for name, p in parts.items()}
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
        probe.send(namespace=side, settle_s=TWO_SENSORS_SETTLE_S)
    for probe in probes.values():
        probe.expect('active', START_TIMEOUT_S)
        probe.send(pattern=None)
    for probe in probes.values():
        probe.expect('measuring', START_TIMEOUT_S)


def _sensors_table(report: dict[str, Any]) -> Table:
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
