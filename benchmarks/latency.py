# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Age and rate of forces at a subscriber, losses and processor time, on the virtual sensor.

Driver, estimator and virtual sensor run as `mixtac up --device virtual` runs them, and play their
scenario. The age of a force is the time of its arrival less its stamp, the end of its window. A
long run (`--seconds 3600`) shows slopes of memory, descriptors and rates: a soak test.
"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import numpy as np
import psutil
import typer
from rich.console import Console

from mixtac.figures import make_table
from mixtac.monitor_node import Monitor
from mixtac.options import JsonFile
from mixtac.up import start_nodes
from mixtac_core.node.files import write_json
from mixtac_core.node.graph import sensor_graph
from mixtac_core.node.process import ProcessGroup

NAMESPACE = 'mixtac_latency'
WINDOW_NS = 2_000_000
"""Time between two forces [ns]."""
PERIOD_S = 5.0
"""Time between two samples of memory and processor time [s]."""


def measure(seconds: float) -> dict[str, Any]:
    """Return the figures, ready for JSON.

    Args:
        seconds: Length of the measurement [s].

    Raises:
        GraphError: A node did not start, or ended.
    """
    nodes = sensor_graph('virtual', virtual_sensor={'loop': True, 'reference_topic': 'reference'})
    samples: list[dict[str, float]] = []
    with ProcessGroup() as group, Monitor(NAMESPACE, group, seconds + 60.0) as monitor:
        start_nodes(group, nodes, NAMESPACE, log_level='warn')
        monitor.listen()
        monitor.wait(lambda: monitor.estimate.received > 0, 'the first force')
        monitor.trigger('virtual_sensor/play')
        processes = {each.name: psutil.Process(group.pid(each.name)) for each in nodes}
        first, began_s = len(monitor.estimate.samples()[1]), time.monotonic()
        while (elapsed_s := time.monotonic() - began_s) < seconds:
            time.sleep(min(PERIOD_S, seconds - elapsed_s))
            group.check()
            samples.append({'t_s': time.monotonic() - began_s, **resources(processes)})
        arrival_ns, stamp_ns = monitor.estimate.samples()[0][:, first:]
        stopped_s = float(monitor.values('virtual_sensor').get('lost_us', 0)) / 1e6
    age_ms = (arrival_ns - stamp_ns) / 1e6
    return {
        'simulated': True,
        'seconds': samples[-1]['t_s'],
        'force_hz': (len(stamp_ns) - 1) / (1e-9 * float(stamp_ns[-1] - stamp_ns[0])),
        'force_age_p50_ms': float(np.quantile(age_ms, 0.5)),
        'force_age_p99_ms': float(np.quantile(age_ms, 0.99)),
        'force_age_max_ms': float(age_ms.max()),
        'forces_lost': int(np.maximum(np.diff(stamp_ns) // WINDOW_NS - 1, 0).sum()),
        'time_stopped_s': stopped_s,
        'slopes': slopes(samples),
        'samples': samples,
    }


def resources(processes: Mapping[str, psutil.Process]) -> dict[str, float]:
    """Return memory [MiB], descriptors, threads and processor time [s] of processes by name."""
    found: dict[str, float] = {}
    for name, process in processes.items():
        with process.oneshot():
            times = process.cpu_times()
            found[f'{name} rss [MiB]'] = process.memory_info().rss / (1 << 20)
            found[f'{name} descriptors'] = process.num_fds()
            found[f'{name} threads'] = process.num_threads()
            found[f'{name} cpu [s]'] = times.user + times.system
    return found


def slopes(samples: Sequence[Mapping[str, float]]) -> dict[str, dict[str, float]]:
    """Return mean, slope per hour and its standard error of each figure, from three samples on."""
    if len(samples) < 3:
        return {}
    found: dict[str, dict[str, float]] = {}
    t = np.array([each['t_s'] for each in samples]) / 3600.0
    centred = t - t.mean()
    spread = float(centred @ centred)
    for name in sorted(set(samples[0]) - {'t_s'}):
        y = np.array([each[name] for each in samples])
        slope = float(centred @ y) / spread
        rest = y - y.mean() - slope * centred
        error = float(np.sqrt(rest @ rest / (len(t) - 2) / spread))
        found[name] = {'mean': float(y.mean()), 'per_hour': slope, 'standard_error': error}
    return found


def latency(
    seconds: Annotated[float, typer.Option(min=3, help='Length of the run (s).')] = 30.0,
    json: JsonFile = None,
) -> None:
    """Measure the age of forces, and losses, on the virtual sensor."""
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    report = measure(seconds)
    names = ('force_hz', 'forces_lost', 'time_stopped_s')
    ages = ('force_age_p50_ms', 'force_age_p99_ms', 'force_age_max_ms')
    rows = [(name, f'{report[name]:.4g}') for name in (*ages, *names)]
    rows += [
        (f'{name} per hour', f'{row["per_hour"]:.4g}') for name, row in report['slopes'].items()
    ]
    Console(markup=False).print(make_table('Forces, virtual sensor', ('figure', ''), rows))
    write_json(json, report)


if __name__ == '__main__':
    typer.run(latency)
