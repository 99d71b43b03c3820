# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac demo`: the whole path from the virtual camera to the force, shown and measured."""

from __future__ import annotations

import json
import os
import time
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np

from mixtac_bringup import evaluation
from mixtac_bringup.bag_reader import BagFile
from mixtac_bringup.demo_phases import phases
from mixtac_bringup.errors import GraphError
from mixtac_bringup.figure import draw_run
from mixtac_bringup.graph import sensor_graph
from mixtac_bringup.live_view import LiveView
from mixtac_bringup.monitor_node import Monitor
from mixtac_bringup.processes import ProcessGroup
from mixtac_bringup.topics import REFERENCE
from mixtac_bringup.up import recorder

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray
    from rich.console import Console

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
