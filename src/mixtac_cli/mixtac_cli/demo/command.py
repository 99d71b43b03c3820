# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac demo`: the whole path from the virtual camera to the force, shown live and measured."""

from __future__ import annotations

import datetime as dt
import json
import os
import time
from collections import deque
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Optional

import numpy as np
import typer
from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from mixtac_cli.demo import evaluation
from mixtac_cli.demo.evaluation import draw_run, phases
from mixtac_cli.monitor_node import Monitor
from mixtac_node.graph import recorder, sensor_graph
from mixtac_node.process import GraphError, ProcessGroup
from mixtac_node.topics import REFERENCE
from mixtac_recordings.bag import BagFile

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray


def print_summary(console: Console, report: DemoReport, folder: Path) -> None:
    """Print what a demo measured and where its bag and figure are."""
    table = Table(title='Measured on the virtual sensor (simulated)', title_justify='left')
    table.add_column('figure')
    table.add_column('value', justify='right')
    for name, value in _rows(report):
        table.add_row(name, value)
    console.print(table)
    console.print(f'figure   {folder / "demo.png"}', soft_wrap=True)
    console.print(f'bag      {folder / "bag"}', soft_wrap=True)
    console.print(f'summary  {folder / "demo.json"}', soft_wrap=True)


def _rows(report: DemoReport) -> list[tuple[str, str]]:
    latency = report.latency_ms
    return [
        ('event rate, mean', f'{report.event_rate_mev_s:.3f} Mev/s'),
        ('event rate, highest in 10 ms', f'{report.peak_event_rate_mev_s:.2f} Mev/s'),
        ('event packets', f'{report.packet_hz:.0f} Hz'),
        ('force', f'{report.force_hz:.1f} Hz'),
        ('latency p50 / p99', f'{latency["p50"]:.2f} / {latency["p99"]:.2f} ms'),
        ('error against the reference, MAE / RMSE', f'{report.mae_n:.3f} / {report.rmse_n:.3f} N'),
        ('  best constant guess, MAE', f'{report.constant_mae_n:.3f} N'),
        ('error against the simulated force, MAE', f'{report.truth_mae_n:.3f} N'),
        ('reference clock drift found', f'{report.clock_drift_ppm:.1f} ppm'),
        ('lost: force samples', str(report.lost)),
        ('lost: event packets', str(report.lost_packets)),
        ('dropped inside nodes', str(report.dropped)),
    ]


_BLOCKS = ' ▁▂▃▄▅▆▇█'
_PERIOD_S = 0.2
_PLAIN_PERIOD_S = 2.0


class LiveView:
    """Shows rates and forces; a table in a terminal, a line now and then elsewhere.

    Args:
        console: Where to show it.
        monitor: What to show.
        namespace: Namespace of the sensor.
        width: Length of the force history in characters.
    """

    def __init__(self, console: Console, monitor: Monitor, namespace: str, width: int = 60) -> None:
        self._console = console
        self._monitor = monitor
        self._namespace = namespace.strip('/')
        self._estimates: deque[float] = deque(maxlen=width)
        self._references: deque[float] = deque(maxlen=width)
        self._last = (time.monotonic(), 0, 0)
        self._rates = (0.0, 0.0)

    def show(self, seconds: float, check: Callable[[], None]) -> None:
        """Show for a while; `check` is called all along and may raise to end it."""
        end = time.monotonic() + seconds
        if not self._console.is_terminal:
            self._show_plain(end, check)
            return
        with Live(self._table(0.0), console=self._console, refresh_per_second=5) as live:
            while (left := end - time.monotonic()) > 0:
                time.sleep(min(_PERIOD_S, left))
                check()
                self._sample()
                live.update(self._table(left))

    def _show_plain(self, end: float, check: Callable[[], None]) -> None:
        next_line = time.monotonic() + _PLAIN_PERIOD_S
        while (left := end - time.monotonic()) > 0:
            time.sleep(min(_PERIOD_S, left))
            check()
            if time.monotonic() >= next_line:
                next_line += _PLAIN_PERIOD_S
                self._sample()
                self._console.print(
                    f'{left:5.1f} s left  force {self._estimates[-1]:7.3f} N  reference '
                    f'{self._references[-1]:7.3f} N  {self._rates[0]:5.0f} Hz  {self._events()}'
                )

    def _sample(self) -> None:
        now, forces, references = (
            time.monotonic(),
            self._monitor.force_count,
            self._monitor.reference_count,
        )
        then, old_forces, old_references = self._last
        span = max(now - then, 1e-6)
        self._rates = ((forces - old_forces) / span, (references - old_references) / span)
        self._last = (now, forces, references)
        _, _, force = self._monitor.force()
        self._estimates.append(float(force[-1]) if len(force) else float('nan'))
        self._references.append(self._monitor.reference_n)

    def _events(self) -> str:
        values = self._monitor.diagnostics.get(f'{self._namespace}/driver', {})
        shown = (
            ('events', 'kev/s', 1e-3),
            ('packets', 'packets/s', 1.0),
            ('frames', 'frames/s', 1.0),
        )
        return '  '.join(
            f'{float(values[f"{key} per second"]) * scale:.0f} {unit}'
            for key, unit, scale in shown
            if f'{key} per second' in values
        )

    def _table(self, left: float) -> Table:
        table = Table(title=f'Mixtac, {left:.0f} s left', title_justify='left', show_header=False)
        peak = max([1.0, *(v for v in (*self._estimates, *self._references) if v == v)])  # noqa: PLR0124
        for name, history, rate in (
            ('estimate', self._estimates, self._rates[0]),
            ('reference', self._references, self._rates[1]),
        ):
            latest = history[-1] if history else float('nan')
            table.add_row(
                name, f'{latest:7.3f} N', Text(_sparkline(history, peak)), f'{rate:5.0f} Hz'
            )
        table.add_row('camera', '', self._events(), '')
        return table


def _sparkline(values: deque[float], peak: float) -> str:
    top = len(_BLOCKS) - 1
    return ''.join(
        _BLOCKS[min(top, max(0, round(value / peak * top)))] if value == value else ' '  # noqa: PLR0124
        for value in values
    )


NAMESPACE = 'mixtac'
SETTLE_S = 1.0
START_UP_S = 60.0
TAIL_S = 1.0


@dataclass(frozen=True)
class DemoReport:
    """What a demo run measured; simulated sensor, real processes and middleware.

    Attributes:
        seconds: Length of the scenario [s].
        seed: Seed of the scenario.
        device_seed: Seed of the virtual sensor's build.
        force_hz: Rate of `/mixtac/force` at a subscriber in another process.
        lost: Force samples missing at that subscriber, by their stamps.
        latency_ms: From the end of a window to its force at the subscriber, p50 and p99.
        mae_n: Mean absolute error against the reference, aligned by the two impulses.
        rmse_n: Root mean square error against the same.
        constant_mae_n: Error of the best constant guess on the same samples.
        truth_mae_n: Mean absolute error against the simulated force itself.
        event_rate_mev_s: Mean event rate.
        peak_event_rate_mev_s: Highest event rate in 10 ms.
        packet_hz: Rate of event packets.
        lost_packets: Event packets missing in the recording.
        dropped: Words, packets and messages that the nodes say they dropped.
        clock_drift_ppm: Drift of the reference clock found by the alignment.
    """

    seconds: float
    seed: int
    device_seed: int
    force_hz: float
    lost: int
    latency_ms: dict[str, float]
    mae_n: float
    rmse_n: float
    constant_mae_n: float
    truth_mae_n: float
    event_rate_mev_s: float
    peak_event_rate_mev_s: float
    packet_hz: float
    lost_packets: int
    dropped: int
    clock_drift_ppm: float


@dataclass(frozen=True)
class Scenario:
    """What a demo does, on which virtual sensor, with which model.

    Attributes:
        seconds: Length [s].
        seed: Seed of the day: forces, contact point, noise, clocks.
        device_seed: Seed of the virtual sensor: beads, gel, lamp, pixels.
        model: Weight file, or None for the shipped one.
    """

    seconds: float
    seed: int
    device_seed: int
    model: Path | None = None


def run_demo(
    console: Console, scenario: Scenario, out: Path, json_file: Path | None = None
) -> DemoReport:
    """Run the graph on the virtual sensor through a scripted scenario and measure it.

    Args:
        console: Where to show the run and its summary.
        scenario: What to do.
        out: New folder for the bag, the figure and the logs.
        json_file: Where to write the report as well, or None.

    Raises:
        GraphError: A node failed.
        AlignmentError: The reference could not be aligned.
    """
    _private_domain(console)
    out.mkdir(parents=True)
    bag_path = out / 'bag'
    dropped, pairs, arrival, stamp = _run_graph(console, scenario, out, bag_path)
    console.print('aligning and comparing')
    with BagFile(bag_path) as bag:
        streams = evaluation.read_streams(bag, NAMESPACE, REFERENCE)
        truth_ns, truth_n = bag.wrenches(f'/{NAMESPACE}/truth/wrench')
    comparison = evaluation.compare(streams)
    latency = evaluation.latency_ms(arrival, stamp, pairs)
    rate = evaluation.event_rate(streams, comparison)
    report = DemoReport(
        seconds=scenario.seconds,
        seed=scenario.seed,
        device_seed=scenario.device_seed,
        force_hz=evaluation.rate_hz(arrival),
        lost=evaluation.lost_windows(stamp),
        latency_ms={
            'p50': float(np.quantile(latency, 0.5)),
            'p99': float(np.quantile(latency, 0.99)),
        },
        mae_n=comparison.mae_n,
        rmse_n=comparison.rmse_n,
        constant_mae_n=comparison.constant_mae_n,
        truth_mae_n=_truth_mae(streams, truth_ns, truth_n, pairs),
        event_rate_mev_s=float(rate[1].mean() / 1e6),
        peak_event_rate_mev_s=float(rate[1].max() / 1e6),
        packet_hz=streams.packets / (np.ptp(streams.force_ns) / 1e9),
        lost_packets=streams.lost_packets,
        dropped=dropped,
        clock_drift_ppm=comparison.fit.drift_ppm,
    )
    draw_run(
        out / 'demo.png', comparison, rate, phases(scenario.seconds, scenario.seed), _title(report)
    )
    text = json.dumps(asdict(report), indent=1)
    (out / 'demo.json').write_text(text + '\n')
    if json_file is not None:
        json_file.write_text(text + '\n')
    return report


def _private_domain(console: Console) -> None:
    # A demo must neither be heard by other ROS graphs of this machine nor hear them.
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    if 'ROS_DOMAIN_ID' not in os.environ:
        os.environ['ROS_DOMAIN_ID'] = str(1 + os.getpid() % 100)
    console.print(f'ROS_DOMAIN_ID={os.environ["ROS_DOMAIN_ID"]} (for tools in another terminal)')


def _run_graph(
    console: Console, scenario: Scenario, out: Path, bag: Path
) -> tuple[int, NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Run the nodes through the scenario; return drops, clock pairs, arrivals and stamps."""
    virtual_sensor = {
        'seed': scenario.seed,
        'device_seed': scenario.device_seed,
        'scenario': 'demo',
        'seconds': float(scenario.seconds),
        'play_on_start': False,
        'loop': False,
    }
    estimator = {} if scenario.model is None else {'model': str(scenario.model.resolve())}
    sensor = sensor_graph('virtual', virtual_sensor=virtual_sensor, estimator=estimator)
    nodes = [*sensor, recorder(bag)]
    console.print('starting virtual sensor, driver, estimator and recorder')
    with (
        ProcessGroup(out / 'log') as processes,
        Monitor(NAMESPACE, scenario.seconds + START_UP_S) as monitor,
    ):
        for node in nodes:
            processes.start(node.name, node.command(NAMESPACE))
        for node in nodes:
            if node.lifecycle:
                monitor.bring_up(node.name, processes)
        monitor.listen()
        monitor.wait_for_force(processes.check)
        # The first half second after discovery is often lost, which says nothing of the sensor.
        time.sleep(SETTLE_S)
        monitor.trigger('virtual_sensor/play', processes.check)
        first = monitor.force_count
        LiveView(console, monitor, NAMESPACE).show(scenario.seconds + TAIL_S, processes.check)
        arrival, stamp, _ = monitor.force()
        dropped = _dropped(monitor)
        pairs = monitor.clock_pairs()
        processes.stop('recorder')
        failed = {name: code for name, code in processes.stop().items() if code}
    if failed:
        raise GraphError(f'nodes did not end cleanly: {failed}; see {out / "log"}')
    return dropped, pairs, arrival[first:], stamp[first:]


def _dropped(monitor: Monitor) -> int:
    return sum(
        int(float(value))
        for values in monitor.diagnostics.values()
        for key, value in values.items()
        if 'dropped' in key
    )


def _truth_mae(
    streams: evaluation.Streams,
    truth_ns: NDArray[np.int64],
    truth_n: NDArray[np.float64],
    pairs: NDArray[np.int64],
) -> float:
    offset = np.interp(streams.force_ns, pairs[:, 1], (pairs[:, 0] - pairs[:, 1]).astype(float))
    host = streams.force_ns + offset
    inside = (host >= truth_ns[0]) & (host <= truth_ns[-1])
    truth = np.interp(host[inside], truth_ns, truth_n)
    return float(np.abs(streams.force_n[inside] - truth).mean())


def _title(report: DemoReport) -> str:
    return (
        f'Virtual sensor (simulated), seed {report.seed}: MAE {report.mae_n:.3f} N against the '
        f'aligned reference, {report.force_hz:.1f} Hz, {report.lost} lost'
    )


OptionalPath = Optional[Path]  # noqa: UP045  (typer evaluates this under Python 3.10)


def demo(
    seconds: Annotated[float, typer.Option(min=12, max=3600, help='Length of the scenario.')] = 30,
    seed: Annotated[int, typer.Option(min=0, help='Forces, contact point, noise, clocks.')] = 1001,
    device_seed: Annotated[
        int, typer.Option(min=0, help='Which virtual sensor: beads, gel, lamp, pixels.')
    ] = 1001,
    model: Annotated[
        OptionalPath, typer.Option(help='Weight file to use instead of the shipped one.')
    ] = None,
    json: Annotated[OptionalPath, typer.Option(help='Write the summary there as well.')] = None,
    out: Annotated[OptionalPath, typer.Option(help='New folder for bag, figure and logs.')] = None,
) -> None:
    """Bring the graph up on the virtual sensor, show it live, then measure and draw the run."""
    console = Console()
    now = dt.datetime.now().astimezone()
    folder = out or Path('demo_out') / f'{now:%Y%m%d-%H%M%S}'
    scenario = Scenario(seconds, seed, device_seed, model)
    report = run_demo(console, scenario, folder, json)
    print_summary(console, report, folder)
