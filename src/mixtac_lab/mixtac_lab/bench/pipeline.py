# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Age of events and forces at a subscriber in another process, losses, rates and CPU time.

`pipeline` measures the driver: a virtual camera sends a pattern over its USB protocol to the driver
node as shipped. `compose` measures driver and estimator, in separate processes and in one.
`two_sensors` runs two virtual sensors with two estimators at once. The age of an event is the host
time at which its packet arrives at the subscriber minus the true time of the event; the age of a
force counts from the end of its window.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from enum import Enum
from typing import Annotated, Any, Optional

import numpy as np
import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from mixtac_cli.figures import make_table
from mixtac_cli.options import JsonFile
from mixtac_lab.bench.harness import START_TIMEOUT_S, BenchRun
from mixtac_node.files import write_json
from mixtac_node.graph import NodeSpec, sensor_graph
from mixtac_node.process import GraphError, JsonProcess

NAMESPACE = 'mixtac_bench'
SETTLE_S = 2.0
FORCE_SETTLE_S = 3.0
TWO_SENSORS_SETTLE_S = 5.0
AGE_RATE = 1e6
LOSS_RATE = 5e6
SENSOR_RATE = 12e6
"""Approximate maximum rate of the sensor."""
FRAME_INTERVAL_US = 25_000
READING_INTERVAL_US = 1000
LADDER = (5e6, SENSOR_RATE, 20e6, 30e6, 40e6)
STEP_SECONDS = 10.0
AGES = ('force_age_p50_ms', 'force_age_p99_ms', 'force_age_max_ms')
SIDES = {'left': 5, 'right': 6}
"""Namespaces, and the seeds of their virtual sensors, which determine the serial numbers."""


@dataclass(frozen=True, slots=True)
class Load:
    """Data that the camera sends.

    Attributes:
        rate: Events per second.
        per_row: Mean number of events per row.
        frame_interval: Time between frames [us], 0 for none.
        reading_interval: Time between inertial samples [us], 0 for none.
    """

    rate: float
    per_row: float = 1.0
    frame_interval: int = 0
    reading_interval: int = 0

    def start(self, run: BenchRun) -> tuple[str, dict[str, Any]]:
        """Start a camera with this load; returns as `BenchRun.start_camera`."""
        return run.start_camera('pattern', **asdict(self))


def full_load(rate: float) -> Load:
    """Return a load with frames and inertial samples."""
    return Load(rate, frame_interval=FRAME_INTERVAL_US, reading_interval=READING_INTERVAL_US)


def is_clean(run: Mapping[str, Any]) -> bool:
    """Return whether everything that was sent in a run of `run_pipeline` arrived."""
    lost = run['events_lost'] or run['packets_lost'] or run['camera_stalls']
    return not lost and run['periods'] > 0


def pattern_of(run: BenchRun, sent: Mapping[str, Any], origin: Mapping[str, Any]) -> dict[str, int]:
    """Return the arguments of `Arrivals` for a running camera.

    Args:
        run: Processes; one is named `camera`.
        sent: Description by the camera of what it sends.
        origin: First origin of its clock that it reported.
    """
    # A start lets the clock run and then resets it: only the last origin counts.
    latest = run.processes['camera'].latest('origin_ns', dict(origin))
    return {
        'origin_ns': latest['origin_ns'],
        'period_us': sent['period_us'],
        'events': sent['events'],
    }


def run_pipeline(
    load: Load, seconds: float, progress: Callable[[float], None] = lambda _seconds: None
) -> dict[str, Any]:
    """Run camera, driver and subscriber, and measure.

    Args:
        load: Load of the camera.
        seconds: Length of the measurement [s].
        progress: Called repeatedly with the elapsed seconds.

    Returns:
        For JSON: `rate_mev_s` of the load; `seconds`, length of the measurement [s]; ages and
        losses, see `mixtac_lab.bench.harness.Arrivals.summary`; `camera_stalls`, number of buffer
        overflows of the camera; `driver_cpu`, `driver_cpu_per_mev_s` and `subscriber_cpu`, CPU time
        over time.

    Raises:
        GraphError: A process did not start.
    """
    with BenchRun() as run:
        device, sent = load.start(run)
        probe = run.start_program('subscriber', 'probe_node')
        probe.expect('ready', START_TIMEOUT_S)
        driver = NodeSpec('mixtac_driver', 'driver_node', 'driver', overrides={'device': device})
        run.start_node('driver', driver, NAMESPACE)
        camera = run.processes['camera']
        origin = camera.expect('origin_ns', START_TIMEOUT_S)
        run.measure(SETTLE_S)
        pattern = pattern_of(run, sent, origin)
        probe.send(probe='events', namespace=f'/{NAMESPACE}', pattern=pattern)
        probe.expect('measuring', START_TIMEOUT_S)
        elapsed_s, cpu = run.measure(seconds, progress)
        probe.stop()
        figures = probe.expect('events_lost', START_TIMEOUT_S)
        run.processes['driver'].stop()
        camera.stop()
        stalls = int(camera.expect('periods_lost', START_TIMEOUT_S)['periods_lost'])
    rate = load.rate / 1e6
    return {
        'rate_mev_s': rate,
        'seconds': elapsed_s,
        **figures,
        'camera_stalls': stalls,
        'driver_cpu': cpu['driver'],
        'driver_cpu_per_mev_s': cpu['driver'] / rate,
        'subscriber_cpu': cpu['subscriber'],
    }


def measure(
    seconds: float, loss_seconds: float, start: Callable[[str, float], Callable[[float], None]]
) -> list[dict[str, Any]]:
    """Do all runs.

    Args:
        seconds: Length of the run at 1 Mev/s [s].
        loss_seconds: Length of the run at 5 Mev/s [s].
        start: Called with name and length of each run; returns a function that is called with the
            elapsed seconds.

    Returns:
        Runs at 1 Mev/s, at 5 Mev/s, and at growing rates with frames and inertial samples, up to
        the first loss.
    """
    age = run_pipeline(Load(AGE_RATE), seconds, progress=start('age at 1 Mev/s', seconds))
    loss = run_pipeline(Load(LOSS_RATE), loss_seconds, progress=start('5 Mev/s', loss_seconds))
    runs = [age, loss]
    for rate in LADDER:
        name = f'{rate / 1e6:g} Mev/s, frames, IMU'
        progress = start(name, STEP_SECONDS)
        runs.append(run_pipeline(full_load(rate), STEP_SECONDS, progress=progress))
        if not is_clean(runs[-1]):
            break
    return runs


def summarise_pipeline(
    age: dict[str, Any], loss: dict[str, Any], *ladder: dict[str, Any]
) -> dict[str, Any]:
    """Return the runs of `measure` and their main figures for JSON."""
    rates = [run['rate_mev_s'] for run in ladder if is_clean(run)]
    return {
        'age_ms': {name: age[f'age_{name}_ms'] for name in ('p50', 'p99')},
        'lost': loss['events_lost'],
        'max_rate_mev_s': max(rates, default=0.0),
        'driver_cpu_per_mev_s': loss['driver_cpu_per_mev_s'],
        'simulated_camera': True,
        'runs': {'age': age, 'loss': loss, 'ladder': list(ladder)},
    }


def pipeline(
    seconds: Annotated[float, typer.Option(min=2, help='Length of the run at 1 Mev/s (s).')] = 30,
    loss_seconds: Annotated[
        float, typer.Option(min=2, help='Length of the run at 5 Mev/s (s).')
    ] = 60,
    json: JsonFile = None,
) -> None:
    """Measure the age of events at a subscriber, losses, and the largest rate without loss."""
    console = Console(markup=False)
    columns = (TextColumn('{task.description}'), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console) as bars:

        def start(name: str, length: float) -> Callable[[float], None]:
            bar = bars.add_task(name, total=length)
            return lambda done: bars.update(bar, completed=done)

        runs = measure(seconds, loss_seconds, start)
    report = summarise_pipeline(*runs)
    console.print(_pipeline_table(runs))
    console.print(f'largest rate without loss: {report["max_rate_mev_s"]:g} Mev/s')
    write_json(json, report)


def _pipeline_table(runs: Sequence[Mapping[str, Any]]) -> Table:
    headings = ('Mev/s', 'frames', 's', 'age p50 ms', 'p99 ms', 'max ms', 'events lost')
    return make_table(
        'Events of a simulated camera at a subscriber in another process',
        (*headings, 'driver CPU', 'subscriber CPU'),
        [
            (
                f'{run["rate_mev_s"]:g}',
                'yes' if number > 1 else 'no',
                f'{run["seconds"]:.0f}',
                f'{run["age_p50_ms"]:.2f}',
                f'{run["age_p99_ms"]:.2f}',
                f'{run["age_max_ms"]:.1f}',
                f'{run["events_lost"]} + camera' if run['camera_stalls'] else run['events_lost'],
                f'{run["driver_cpu"]:.0%}',
                f'{run["subscriber_cpu"]:.0%}',
            )
            for number, run in enumerate(runs)
        ],
    )


class Kind(Enum):
    """Arrangement of driver and estimator in processes."""

    SEPARATE = 'separate'
    ONE = 'one'


def compose(
    seconds: Annotated[float, typer.Option(min=2, help='Length of each run (s).')] = 20,
    repeats: Annotated[int, typer.Option(min=1, help='Runs of each kind, alternating.')] = 3,
    rate: Annotated[float, typer.Option(min=1000, help='Events per second.')] = AGE_RATE,
    only: Annotated[
        Optional[Kind],  # noqa: UP045  (typer evaluates this under Python 3.10)
        typer.Option(help='Run one kind only, for a long measurement.'),
    ] = None,
    json: JsonFile = None,
) -> None:
    """Measure the age of forces at a subscriber, from separate processes and from one."""
    console = Console(markup=False)
    runs = []
    kinds = [only] if only is not None else list(Kind)
    with console.status('measuring'):
        for _ in range(repeats):
            runs += [run_force(full_load(rate), seconds, together=k is Kind.ONE) for k in kinds]
    console.print(_runs_table(runs))
    write_json(json, summarise(runs, rate))


def run_force(load: Load, seconds: float, *, together: bool) -> dict[str, Any]:
    """Run camera, driver, estimator and subscriber, and measure.

    Args:
        load: Load of the camera; it needs frames.
        seconds: Length of the measurement [s].
        together: Run driver and estimator in one process.

    Returns:
        `single_process`, the figures of `programs.probe_node.force_figures`, `cpu` by process,
        `cpu_total`, and for separate processes `driver_core_share_per_mev_s`.

    Raises:
        GraphError: A process did not start, or no force arrived.
    """
    with BenchRun() as run:
        device, sent = load.start(run)
        probe = run.start_program('subscriber', 'probe_node')
        probe.expect('ready', START_TIMEOUT_S)
        # No contact makes these events and frames: their forces are not valid.
        estimator = {'invalid_force': 'publish'}
        graph = sensor_graph(device, estimator=estimator, single_process=together)
        nodes = [node for node in graph if node.name != 'virtual_sensor']
        for node in nodes:
            run.start_node(node.name, node, NAMESPACE)
        origin = run.processes['camera'].expect('origin_ns', START_TIMEOUT_S)
        probe.send(probe='force', namespace=f'/{NAMESPACE}', settle_s=FORCE_SETTLE_S)
        probe.expect('active', START_TIMEOUT_S)
        probe.send(pattern=pattern_of(run, sent, origin))
        probe.expect('measuring', START_TIMEOUT_S)
        _, shares = run.measure(seconds)
        probe.stop()
        figures = probe.expect('forces', START_TIMEOUT_S)
    if not figures['forces']:
        raise GraphError(
            'no force arrived', remedy='run `mixtac up --device virtual` and read /diagnostics'
        )
    cpu = {node.name: shares[node.name] for node in nodes}
    report = {'single_process': together, **figures, 'cpu': cpu, 'cpu_total': sum(cpu.values())}
    if not together:
        report['driver_core_share_per_mev_s'] = cpu['driver'] / (load.rate / 1e6)
    return report


def summarise(runs: Sequence[Mapping[str, Any]], rate: float) -> dict[str, Any]:
    """Return medians of each kind and all runs for JSON."""
    summary: dict[str, Any] = {}
    for name, together in (('separate', False), ('single_process', True)):
        kind = [run for run in runs if run['single_process'] == together]
        if not kind:
            continue
        keys = [*AGES, 'force_rate_hz', 'cpu_total']
        if not together:
            keys.append('driver_core_share_per_mev_s')
        summary[name] = {key: float(np.median([run[key] for run in kind])) for key in keys}
        summary[name]['windows_missing'] = sum(run['windows_missing'] for run in kind)
    return {'simulated_camera': True, 'events_per_s': rate, **summary, 'runs': list(runs)}


def _runs_table(runs: Sequence[Mapping[str, Any]]) -> Table:
    return make_table(
        'Age of the force at a subscriber: arrival minus the end of its window (simulated camera)',
        ('processes', 'p50 ms', 'p99 ms', 'max ms', 'Hz', 'windows missing', 'CPU'),
        [
            (
                'one' if run['single_process'] else 'separate',
                *(f'{run[key]:.2f}' for key in AGES),
                f'{run["force_rate_hz"]:.1f}',
                run['windows_missing'],
                f'{run["cpu_total"]:.0%}',
            )
            for run in sorted(runs, key=lambda each: bool(each['single_process']))
        ],
    )


def two_sensors(
    seconds: Annotated[float, typer.Option(min=2, help='Length of the measurement (s).')] = 20,
    single_process: Annotated[
        bool, typer.Option(help='Run each driver and its estimator in one process.')
    ] = False,
    json: JsonFile = None,
) -> None:
    """Measure rates, ages and CPU of two virtual sensors with two estimators at once."""
    console = Console(markup=False)
    with console.status('measuring'):
        report = run_two(seconds, together=single_process)
    console.print(_sensors_table(report))
    write_json(json, report)


def run_two(seconds: float, *, together: bool) -> dict[str, Any]:
    """Run both sensors and return their figures for JSON.

    Args:
        seconds: Length of the measurement [s].
        together: Run each driver and its estimator in one process.

    Raises:
        GraphError: A process did not start.
    """
    with BenchRun() as run:
        probes: dict[str, JsonProcess] = {}
        for side, seed in SIDES.items():
            # At rest: contacts of two sensors would not coincide from run to run.
            virtual = {
                'device_seed': seed,
                'scenario': 'idle',
                'reference_topic': f'/{side}/ft_sensor/wrench',
            }
            device = f'virtual:{run.folder}/{side}.sock'
            graph = sensor_graph(device, virtual_sensor=virtual, single_process=together)
            for node in graph:
                run.start_node(f'{side}/{node.name}', node, side)
            probes[side] = run.start_program(f'{side}/probe', 'probe_node')
        for side, probe in probes.items():
            probe.expect('ready', START_TIMEOUT_S)
            probe.send(probe='force', namespace=f'/{side}', settle_s=TWO_SENSORS_SETTLE_S)
        for probe in probes.values():
            probe.expect('active', START_TIMEOUT_S)
            probe.send(pattern=None)
        for probe in probes.values():
            probe.expect('measuring', START_TIMEOUT_S)
        elapsed_s, shares = run.measure(seconds)
        cpu = {name: share for name, share in shares.items() if not name.endswith('/probe')}
        report: dict[str, Any] = {
            'simulated': True,
            'single_process': together,
            'seconds': elapsed_s,
            'cpu_count': os.cpu_count(),
            'cpu_total': sum(cpu.values()),
        }
        for side, probe in probes.items():
            probe.stop()
            prefix = f'{side}/'
            own = {n.removeprefix(prefix): c for n, c in cpu.items() if n.startswith(prefix)}
            report[side] = {**probe.expect('forces', START_TIMEOUT_S), 'cpu': own}
    return report


def _sensors_table(report: dict[str, Any]) -> Table:
    rows: list[tuple[object, ...]] = []
    for side in SIDES:
        each = report[side]
        if not each['forces']:
            rows.append((side, 'no force'))
            continue
        rows.append(
            (
                side,
                f'{each["force_rate_hz"]:.1f}',
                each['windows_missing'],
                f'{each["force_age_p50_ms"]:.2f}',
                f'{each["force_age_p99_ms"]:.2f}',
                ', '.join(f'{name} {value:.0%}' for name, value in each['cpu'].items()),
            )
        )
    title = f'Two virtual sensors, {report["cpu_count"]} cores, {report["cpu_total"]:.0%} CPU'
    headings = ('sensor', 'Hz', 'windows missing', 'age p50 ms', 'p99 ms', 'CPU')
    return make_table(title, headings, rows)
