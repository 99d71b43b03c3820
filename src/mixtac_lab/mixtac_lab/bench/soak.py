# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A long run of the graph: rates, losses, memory, descriptors, threads and the zero of the force.

A simulated camera sends one pattern again and again over its USB protocol, with frames and inertial
samples; driver and estimator run as shipped. As the picture repeats, the mean force
of a period has no reason to change: its slope is the drift of the zero. Slopes are least squares
over the samples after the start-up, with their standard errors.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import psutil
import typer
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import Progress

from mixtac_cli.figures import make_table, new_axes, save_figure
from mixtac_cli.monitor_node import Monitor
from mixtac_cli.options import JsonFile, OptionalPath
from mixtac_lab.bench.harness import BenchRun
from mixtac_lab.bench.pipeline import AGE_RATE, full_load
from mixtac_node.files import write_json
from mixtac_node.graph import sensor_graph
from mixtac_node.process import GraphError, ProcessGroup

NAMESPACE = 'mixtac_soak'
SETTLE_S = 60.0
"""Start-up that is left out of the slopes [s], at most a quarter of the run."""
WINDOW_NS = 2_000_000
COUNTERS = {
    'fger': ('lost_packets', 'bad_messages', 'late', 'slow_windows', 'frames_dropped', 'withheld'),
    'driver': ('events per second', 'frames per second', 'camera dropped', 'failures'),
}
"""What is taken from the diagnostics of each node."""


def run_soak(
    seconds: float, rate: float, period_s: float, progress: Callable[[float], None]
) -> dict[str, Any]:
    """Run the graph and return the figures for JSON.

    Args:
        seconds: Length of the run [s].
        rate: Events per second of the camera.
        period_s: Time between samples [s].
        progress: Called with the elapsed seconds.

    Returns:
        `samples`, a list of figures by name, `t_s` the time since the first; `slopes` by name, see
        `slopes`; `seconds`, the length of the run.

    Raises:
        GraphError: A process did not start, or ended.
    """
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    samples: list[dict[str, float]] = []
    with (
        BenchRun() as run,
        ProcessGroup(run.folder / 'log', run.environment) as group,
        Monitor(NAMESPACE, seconds + 600.0) as monitor,
    ):
        device, _ = full_load(rate).start(run)
        # No contact makes these events and frames: their forces are not valid.
        graph = sensor_graph(device, estimator={'invalid_force': 'publish'})
        specs = [node for node in graph if node.name != 'virtual_sensor']
        for node in specs:
            group.start(node.name, node.command(NAMESPACE, log_level='warn'))
        monitor.bring_up_all(specs, group)
        monitor.listen()
        monitor.wait_for_force(group.check)
        processes = {node.name: psutil.Process(group.pid(node.name)) for node in specs}
        began_s, taken = time.monotonic(), monitor.force_count
        while (elapsed_s := time.monotonic() - began_s) < seconds:
            time.sleep(min(period_s, max(0.0, seconds - elapsed_s)))
            group.check()
            found = {'t_s': time.monotonic() - began_s, **resources(processes)}
            found |= force_figures(*monitor.force(), taken)
            taken = monitor.force_count
            samples.append(found | counters(monitor.values))
            progress(found['t_s'])
    return {
        'simulated': True,
        'events_per_s': rate,
        'seconds': samples[-1]['t_s'],
        'slopes': slopes(samples),
        'samples': samples,
    }


def resources(processes: Mapping[str, psutil.Process]) -> dict[str, float]:
    """Return memory [MiB], descriptors, threads and CPU time [s] of processes by name.

    Raises:
        GraphError: One has ended.
    """
    found: dict[str, float] = {}
    for name, process in processes.items():
        try:
            with process.oneshot():
                times = process.cpu_times()
                found[f'{name} rss [MiB]'] = process.memory_info().rss / (1 << 20)
                found[f'{name} descriptors'] = process.num_fds()
                found[f'{name} threads'] = process.num_threads()
                found[f'{name} cpu [s]'] = times.user + times.system
        except psutil.Error as error:
            raise GraphError(f'{name} has ended: {error}') from error
    return found


def force_figures(
    arrival_ns: NDArray[np.int64],
    stamp_ns: NDArray[np.int64],
    force: NDArray[np.float64],
    first: int,
) -> dict[str, float]:
    """Return rate [Hz], missing windows and mean [N] of the forces of a period.

    Args:
        arrival_ns: Host time of the arrival of all forces so far [ns], [N].
        stamp_ns: Their stamps [ns], [N].
        force: Their values [N], [N].
        first: Number of the first one of the period, at least 1: what is missing before it counts.
    """
    if len(force) <= first:
        return {'force windows missing': 0.0, 'force [Hz]': 0.0}
    span_s = 1e-9 * float(arrival_ns[-1] - arrival_ns[first - 1])
    missing = np.maximum(np.diff(stamp_ns[first - 1 :]) // WINDOW_NS - 1, 0)
    return {
        'force [Hz]': (len(force) - first) / max(span_s, 1e-9),
        'force windows missing': float(missing.sum()),
        'zero [N]': float(np.mean(force[first:])),
    }


def counters(values: Callable[[str], Mapping[str, str]]) -> dict[str, float]:
    """Return the numbers among `COUNTERS` that the nodes report."""
    found: dict[str, Any] = {}
    for node, names in COUNTERS.items():
        reported = values(node)
        found |= {f'{node} {name}': float(reported[name]) for name in names if name in reported}
    return found


def slopes(samples: Sequence[Mapping[str, float]]) -> dict[str, dict[str, float]]:
    """Return mean, slope per hour and its standard error of each figure after the start-up.

    Args:
        samples: In order of `t_s` [s].
    """
    settle_s = min(SETTLE_S, samples[-1]['t_s'] / 4.0)
    late = [each for each in samples if each['t_s'] >= settle_s]
    found: dict[str, dict[str, float]] = {}
    for name in sorted(set().union(*late) - {'t_s'}):
        rows = [(each['t_s'] / 3600.0, each[name]) for each in late if name in each]
        if len(rows) < 3:
            continue
        t, y = np.array(rows).T
        centred = t - t.mean()
        spread = float(centred @ centred)
        slope = float(centred @ y) / spread
        rest = y - y.mean() - slope * centred
        error = float(np.sqrt(rest @ rest / (len(t) - 2) / spread))
        figures = {'mean': float(y.mean()), 'per_hour': slope, 'standard_error': error}
        found[name] = {**figures, 'last': float(y[-1])}
    return found


def soak(
    hours: Annotated[float, typer.Option(min=0.005, help='Length of the run (h).')] = 1.0,
    rate: Annotated[float, typer.Option(min=1000, help='Events per second.')] = AGE_RATE,
    period: Annotated[float, typer.Option(min=1, help='Time between samples (s).')] = 5.0,
    figure: Annotated[OptionalPath, typer.Option(help='Draw the figures to this picture.')] = None,
    json: JsonFile = None,
) -> None:
    """Run the graph for hours; measure rates, losses, and slopes of memory and of the zero."""
    console = Console(markup=False)
    with Progress(console=console, transient=True) as bars:
        bar = bars.add_task('running', total=3600.0 * hours)
        done = lambda seconds: bars.update(bar, completed=seconds)  # noqa: E731
        report = run_soak(3600.0 * hours, rate, period, done)
    rows = [
        (name, *(f'{row[key]:.4g}' for key in ('mean', 'last', 'per_hour', 'standard_error')))
        for name, row in report['slopes'].items()
    ]
    title = f'{report["seconds"] / 60:.1f} minutes at {rate / 1e6:g} Mev/s, simulated camera'
    console.print(make_table(title, ('', 'mean', 'last', 'per hour', '+-'), rows))
    write_json(json, report)
    if figure is not None:
        draw(report['samples'], figure, title)


def draw(samples: Sequence[Mapping[str, float]], path: Path, title: str) -> None:
    """Draw memory, rate and zero over time."""
    canvas, axes = new_axes(rows=3, height=6.0)
    drawn = (('rss [MiB]', ' rss [MiB]'), ('force [Hz]', 'force [Hz]'), ('zero [N]', 'zero [N]'))
    for ax, (label, ending) in zip(axes, drawn, strict=True):
        for name in sorted({name for each in samples for name in each if name.endswith(ending)}):
            rows = [(each['t_s'] / 60.0, each[name]) for each in samples if name in each]
            ax.plot(*np.array(rows).T, label=name.removesuffix(ending))
        ax.set_ylabel(label)
    axes[0].legend()
    axes[0].set_title(title)
    axes[-1].set_xlabel('minutes')
    save_figure(canvas, path)
