# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac demo`: the whole path from the virtual camera to the force, shown live and measured."""

from __future__ import annotations

import datetime as dt
import importlib.util
import os
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console

from mixtac.figures import EVENTS, FORCE, REFERENCE, make_table, new_figure, save_figure
from mixtac.live import sensor_values, show
from mixtac.options import JsonFile, OptionalPath
from mixtac.up import show_without_ros, start_nodes
from mixtac_core.events.codec import decode_message
from mixtac_core.events.windows import counts_per_window
from mixtac_core.node import topics
from mixtac_core.node.files import FileError, write_json
from mixtac_core.node.graph import recorder, sensor_graph
from mixtac_core.node.process import GraphError, ProcessGroup
from mixtac_core.node.stamps import stamp_to_ns
from mixtac_core.node.topics import DEFAULT_NAMESPACE
from mixtac_core.recordings.bag import BagFile
from mixtac_fger.alignment.align import align
from mixtac_fger.alignment.bags import read_recording
from mixtac_fger.alignment.clock_fit import AlignmentError, ClockFit
from mixtac_sim.mechanics.contact import Mode
from mixtac_sim.world.profiles import make_profile
from mixtac_sim.world.segments import Segment

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PRESET: Final = 'paper_like'
"""Difficulty for which the shipped model was trained."""
LEAD_S: Final = 8.0
"""Delay of the scenario after time goes on again [s]."""
TAIL_S: Final = 1.0
"""Time in which what was simulated last reaches the recorder [s]."""
BAG: Final = 'bag'
WINDOW_NS: Final = 2_000_000
"""Time between two forces [ns]."""
RATE_WINDOW_US: Final = 10_000
"""Window in which event rates are counted [us]."""
MAX_FORCE_GAP_S: Final = 2.0
"""A busy host may lose reference samples [s]; here their clock is known to be a single one."""
EDGE_US: Final = 50_000
"""Half a synchronising impulse [us]: the comparison starts and ends with whole impulses."""
NEAR_US: Final = 100_000
"""The rest without a load begins this long after the first impulse [us]."""
FAR_US: Final = 500_000
"""It ends this long after the first impulse [us]; the other rest lies as far before the last."""
TREMOR_N: Final = 0.05
"""Amplitude above which a press counts as an oscillation [N]."""
HELD_PART: Final = 0.8
"""Part of the largest force of the press above which it is held; this calibrates."""
PRESS: Final = 'press and hold'
SHOWN_S: Final = {PRESS: 60.0, 'oscillation': 3.0, 'impact of a dropped weight': 0.8}
"""Longest time of each part that the figure enlarges [s]."""
I64 = NDArray[np.int64]
F64 = NDArray[np.float64]
Spans = dict[str, tuple[float, float]]


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
    if importlib.util.find_spec('rclpy') is None:
        if out or json:
            raise GraphError(
                'without ROS 2 the demo writes nothing', remedy='give neither --out nor --json'
            )
        show_without_ros('virtual:demo', str(model or ''), seconds)
        console.print('./mixtac demo of a checkout brings ROS 2, records, compares and draws')
        return
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
        live = _run_graph(console, processes, folder / BAG, seconds, seed, device_seed, model)
        codes = {**processes.stop('recorder'), **processes.stop()}
    console.print('aligning and comparing')
    settings = {'seconds': seconds, 'seed': seed, 'device_seed': device_seed}
    report = settings | live | evaluate(folder, seconds, seed)
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
) -> dict[str, Any]:
    """Record the scenario while it is shown, and return what only the running nodes report.

    `dropped` counts the transfers, words, frames and messages that nodes dropped; `waited_s` is the
    time for which simulated time stopped during the scenario, because the host was too slow [s].
    """
    from mixtac.monitor_node import Monitor

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
    nodes.append(recorder(bag, exclude=(topics.CONTACT, topics.CONTACT_POINT)))
    console.print('starting virtual sensor, driver, estimator and recorder')
    with Monitor(DEFAULT_NAMESPACE, processes) as monitor:
        start_nodes(processes, nodes)
        monitor.bring_up_all(nodes)
        monitor.listen()
        monitor.wait_for_force()
        values = sensor_values(monitor, reference=True)

        def sensor() -> dict[str, str]:
            processes.check()
            return monitor.values('virtual_sensor')

        def recorder_starts() -> str:
            return '' if sensor() and monitor.values('recorder') else 'the recorder starts'

        def starts() -> str:
            return 'the scenario starts' if sensor().get('plays', '0') == '0' else ''

        def plays() -> str:
            return 'playing the scenario' if sensor()['playing'] == 'True' else ''

        show(console, recorder_starts, values)
        monitor.trigger('virtual_sensor/play')
        show(console, starts, values)
        lost_us = float(sensor().get('lost_us', 0))
        show(console, plays, values)
        time.sleep(TAIL_S)
        dropped = sum(
            int(float(value))
            for node in ('driver', 'fger', 'recorder')
            for key, value in monitor.values(node).items()
            if key.endswith('dropped')
        )
        return {'dropped': dropped, 'waited_s': (float(sensor()['lost_us']) - lost_us) / 1e6}


@dataclass(frozen=True)
class Streams:
    """The streams of a recorded run.

    Attributes:
        event_t_us: Event times, camera clock [us], int64.
        complete_us: Time up to which each event packet is complete, camera clock [us], int64.
        arrival_ns: Arrival of each event packet at the host [ns], int64.
        invalid: Forces that are marked as not valid.
        force_ns: Ends of the force windows, camera clock [ns], int64.
        force_arrival_ns: Arrival of each force at the recorder [ns], int64.
        force_n: Estimated normal force [N].
        reference_ns: Stamps of the reference, reference clock [ns], int64.
        reference_n: Reference normal force [N].
    """

    event_t_us: I64
    complete_us: I64
    arrival_ns: I64
    invalid: int
    force_ns: I64
    force_arrival_ns: I64
    force_n: F64
    reference_ns: I64
    reference_n: F64


@dataclass(frozen=True)
class Comparison:
    """Estimate against reference, on the camera clock.

    Attributes:
        start_us: Camera clock at time 0 below [us].
        time_s: Sample times [s].
        estimate_n: Estimated force before the calibration [N].
        reference_n: Reference force at the same times, less its zero [N].
        zeros_n: Zero of the reference after the first and before the last impulse [N].
        gain: Factor of the force, by which the press is held at the force of the reference.
        judged: Which samples count for the errors: all but those of the press.
    """

    start_us: int
    time_s: F64
    estimate_n: F64
    reference_n: F64
    zeros_n: tuple[float, float]
    gain: float
    judged: NDArray[np.bool_]

    def figures(self) -> dict[str, Any]:
        """Return the figures of the comparison; see `evaluate`."""
        reference, estimate = self.reference_n[self.judged], self.estimate_n[self.judged]
        error = self.gain * estimate - reference
        return {
            'mae_n': float(np.abs(error).mean()),
            'rmse_n': float(np.sqrt((error**2).mean())),
            'mae_uncalibrated_n': float(np.abs(estimate - reference).mean()),
            'gain': self.gain,
            'reference_zero_n': self.zeros_n,
            'constant_mae_n': float(np.abs(reference - np.median(reference)).mean()),
        }


def evaluate(out: Path, seconds: float, seed: int) -> dict[str, Any]:
    """Compare the recorded force with the aligned reference, and draw the run.

    Returns:
        The figures for JSON; simulated sensor, real processes and middleware.

        `force_hz`: Rate of `/mixtac/force` at the recorder during the scenario.
        `lost`: Force samples missing at the recorder, by their stamps.
        `invalid`: Force samples marked as not valid; they are published and count in all figures.
        `latency_ms`: From the arrival of the last packet of a window to its force at the
            recorder, p50 and p99.
        `gain`: Factor of the force by which the press of the scenario calibrates the sensor; this
            and the figures to `aligned_by` are None if the alignment was refused.
        `mae_n`: Mean absolute error of the calibrated force against the reference, aligned as by
            `mixtac align` and less its zero, without the press that calibrates.
        `rmse_n`: Root mean square error of the same samples.
        `mae_uncalibrated_n`: Mean absolute error of the same samples without the calibration.
        `constant_mae_n`: Error of the best constant guess on the same samples.
        `reference_zero_n`: Reading of the reference without a load, before and after [N].
        `clock_drift_ppm`: Drift of the reference clock found by the alignment.
        `aligned_by`: Method of the alignment.
        `event_rate_mev_s`: Mean event rate.
        `peak_event_rate_mev_s`: Highest event rate in 10 ms.
        `refused`: Why the alignment was refused, or empty.
    """
    streams = read_streams(out / BAG, DEFAULT_NAMESPACE)
    spans, refused = phases(seconds, seed), ''
    start_us, end_us = (int(streams.force_ns[at]) // 1000 for at in (0, -1))
    names = ('mae_n', 'rmse_n', 'mae_uncalibrated_n', 'constant_mae_n', 'gain', 'reference_zero_n')
    aligned: dict[str, Any] = dict.fromkeys((*names, 'clock_drift_ppm', 'aligned_by'))
    comparison = None
    try:
        fit = align(read_recording(out / BAG), max_gap_s=MAX_FORCE_GAP_S)
        comparison = compare(streams, fit, spans[PRESS])
        aligned = comparison.figures()
        aligned |= {'clock_drift_ppm': fit.drift_ppm, 'aligned_by': fit.method}
        start_us = comparison.start_us
        end_us = start_us + int(comparison.time_s[-1] * 1e6)
    except AlignmentError as error:
        refused = str(error)
    counts = counts_per_window(streams.event_t_us, start_us, end_us, RATE_WINDOW_US)
    rate = np.asarray(counts * (1e6 / RATE_WINDOW_US), np.float64)
    played = streams.force_ns > streams.force_ns[-1] - round(1e9 * (seconds + TAIL_S))
    latency = latency_ms(streams)[played]
    report: dict[str, Any] = {
        'force_hz': float((len(latency) - 1) * 1e9 / np.ptp(streams.force_arrival_ns[played])),
        'lost': lost_windows(streams.force_ns[played]),
        'invalid': streams.invalid,
        'latency_ms': {f'p{part}': float(np.percentile(latency, part)) for part in (50, 99)},
        **aligned,
        'event_rate_mev_s': float(rate.mean() / 1e6),
        'peak_event_rate_mev_s': float(rate.max() / 1e6),
        'refused': refused,
    }
    if comparison is not None:
        title = (
            f'Virtual sensor (simulated), seed {seed}: MAE {report["mae_n"]:.3f} N against the '
            f'aligned reference, {report["force_hz"]:.1f} Hz, {report["lost"]} lost'
        )
        draw_run(out / 'demo.png', comparison, rate, spans, title)
    return report


def read_streams(path: Path, namespace: str) -> Streams:
    """Read the streams of a virtual sensor from a bag.

    Raises:
        RecordingError: A topic is missing or the bag is damaged.
    """
    events, quality, force = (
        each.resolved(namespace) for each in (topics.EVENTS, topics.FORCE_QUALITY, topics.FORCE)
    )
    times, packets, forces = [np.empty(0, np.int64)], [], []
    invalid = 0
    with BagFile(path) as bag:
        for topic, received_ns, message in bag.messages(events, quality, force):
            if topic == quality:
                invalid += not message.valid
            elif topic == force:
                stamp_ns = stamp_to_ns(message.header.stamp)
                forces.append((stamp_ns, received_ns, topics.normal_force(message)))
            else:
                packet = decode_message(message)
                times.append(packet.events.t)
                packets.append((packet.complete_until, stamp_to_ns(message.header.stamp)))
        reference_ns, reference = bag.wrenches(topics.REFERENCE)
    complete_us, arrival_ns = np.array(packets, np.int64).reshape(-1, 2).T
    force_ns, force_arrival_ns, force_n = zip(*forces, strict=True)
    return Streams(
        event_t_us=np.concatenate(times),
        complete_us=complete_us,
        arrival_ns=arrival_ns,
        invalid=invalid,
        force_ns=np.array(force_ns, np.int64),
        force_arrival_ns=np.array(force_arrival_ns, np.int64),
        force_n=np.array(force_n),
        reference_ns=reference_ns,
        reference_n=reference[:, 2],
    )


def compare(streams: Streams, fit: ClockFit, press_s: tuple[float, float]) -> Comparison:
    """Bring the reference to the camera clock, calibrate by the press, and compare.

    Samples from the first to the last impulse of the fit count, the impulses included. The zero of
    a reference sensor drifts. As on a bench it is measured without a load, before and after;
    between the two it follows a straight line.

    Args:
        streams: The streams of the run.
        fit: Clock fit of the reference.
        press_s: Start and end of the press [s], as from `phases`.
    """
    reference_us = fit.to_camera(streams.reference_ns / 1e9)
    force_us = streams.force_ns // 1000
    first_us, last_us = fit.anchors[0].camera_us, fit.anchors[-1].camera_us
    rests = (first_us + NEAR_US, first_us + FAR_US), (last_us - FAR_US, last_us - NEAR_US)
    before, after = (
        float(streams.reference_n[(reference_us >= start) & (reference_us <= end)].mean())
        for start, end in rests
    )
    zero = np.interp(reference_us, np.mean(rests, axis=1), (before, after))
    start_us = first_us - EDGE_US
    inside = (force_us >= start_us) & (force_us <= last_us + EDGE_US)
    reference = np.interp(force_us[inside], reference_us, streams.reference_n - zero)
    time_s, estimate = (force_us[inside] - start_us) / 1e6, streams.force_n[inside]
    pressed = (time_s >= press_s[0]) & (time_s <= press_s[1])
    held = pressed & (reference > HELD_PART * reference[pressed].max(initial=0.0))
    # Medians: frames that a busy host drops make the estimate wrong for a part of the press.
    felt = float(np.median(estimate[held])) if held.any() else 0.0
    gain = float(np.median(reference[held])) / felt if felt > 0.0 else 1.0
    return Comparison(start_us, time_s, estimate, reference, (before, after), gain, ~pressed)


def lost_windows(stamps_ns: I64) -> int:
    """Return how many 2 ms windows are missing between the first and the last stamp."""
    return int(np.ptp(stamps_ns) // WINDOW_NS) + 1 - len(stamps_ns)


def latency_ms(streams: Streams) -> F64:
    """Return the time from the arrival of a window's last packet to its force [ms].

    The end of the window itself has no time on the host clock where simulated time stops.
    """
    packet = np.searchsorted(streams.complete_us * 1000, streams.force_ns)
    sent_ns = streams.arrival_ns[packet.clip(max=len(streams.arrival_ns) - 1)]
    return np.asarray((streams.force_arrival_ns - sent_ns) / 1e6, np.float64)


def phases(seconds: float, seed: int) -> Spans:
    """Return start and end of each part of the scenario [s, as in the comparison].

    The comparison starts at the first synchronising impulse, whose time the profile holds.

    Args:
        seconds: Length of the scenario [s].
        seed: Its seed.
    """
    profile = make_profile('demo', seed, seconds, sync=True)
    first_s, last_s = profile.sync_s
    origin_s = first_s - EDGE_US / 1e6
    spans: Spans = {}
    for each in profile.segments:
        if first_s < each.start_s and each.end_s < last_s:
            start_s = spans.get(_name(each), (each.start_s - origin_s, 0.0))[0]
            spans[_name(each)] = (start_s, each.end_s - origin_s)
    return spans


def _name(segment: Segment) -> str:
    press, oscillation, impact = SHOWN_S
    if segment.mode >= Mode.DROP:
        return impact
    return oscillation if segment.tones and segment.tones[0].amplitude > TREMOR_N else press


def draw_run(path: Path, comparison: Comparison, rate: F64, spans: Spans, title: str) -> None:
    """Save a figure of a run.

    Args:
        path: File to write; its suffix gives the format.
        comparison: Estimate and aligned reference.
        rate: Event rates [1/s] in windows of 10 ms from the start of the comparison.
        spans: Parts to show enlarged, from `phases`.
        title: Title; says that the data are simulated if they are.

    Raises:
        FileError: The file cannot be written.
    """
    figure = new_figure(11, 7.5)
    grid = figure.add_gridspec(3, len(spans), height_ratios=[3, 1, 3])
    whole = figure.add_subplot(grid[0, :])
    _draw_force(whole, comparison, 0.0, float(comparison.time_s[-1]))
    whole.set_ylim(-0.15, max(1.2, 1.3 * float(np.quantile(comparison.reference_n, 0.99))))
    whole.legend(loc='upper right', ncols=2, frameon=False)
    whole.set_title(title, loc='left')
    events = figure.add_subplot(grid[1, :], sharex=whole)
    centres_s = (np.arange(len(rate)) + 0.5) * RATE_WINDOW_US / 1e6
    events.semilogy(centres_s, np.maximum(rate, 1.0), color=EVENTS, lw=0.8)
    events.set(ylabel='events [1/s]')
    for column, (name, (start_s, end_s)) in enumerate(spans.items()):
        axes = figure.add_subplot(grid[2, column])
        _draw_force(axes, comparison, start_s, min(end_s, start_s + SHOWN_S[name]))
        axes.set_title(f'{name} (calibrates)' if name == PRESS else name, fontsize=10)
        axes.set_xlabel('camera time [s]')
    save_figure(figure, path)


def _draw_force(axes: Axes, comparison: Comparison, start_s: float, end_s: float) -> None:
    shown = (comparison.time_s >= start_s) & (comparison.time_s <= end_s)
    time_s, estimate = comparison.time_s[shown], comparison.gain * comparison.estimate_n[shown]
    axes.plot(time_s, comparison.reference_n[shown], color=REFERENCE, lw=1.4, label='reference')
    axes.plot(time_s, estimate, color=FORCE, lw=1.0, label='estimate')
    axes.set(ylabel='normal force [N]', xlim=(start_s, end_s))
    axes.grid(visible=True, alpha=0.25)


def print_summary(console: Console, report: Mapping[str, Any], folder: Path) -> None:
    """Print the results of a demo and where its bag and figure are."""

    def n(key: str) -> str:
        return '-' if report[key] is None else f'{report[key]:.3f}'

    latency = report['latency_ms']
    rows = [
        ('event rate, mean', f'{n("event_rate_mev_s")} Mev/s'),
        ('event rate, highest in 10 ms', f'{n("peak_event_rate_mev_s")} Mev/s'),
        ('force', f'{report["force_hz"]:.1f} Hz'),
        ('latency p50 / p99', f'{latency["p50"]:.2f} / {latency["p99"]:.2f} ms'),
        ('gain, calibrated by the press', n('gain')),
        ('error against the reference, MAE / RMSE', f'{n("mae_n")} / {n("rmse_n")} N'),
        ('  before the calibration, MAE', f'{n("mae_uncalibrated_n")} N'),
        ('  best constant guess, MAE', f'{n("constant_mae_n")} N'),
        ('drift of the reference clock', f'{n("clock_drift_ppm")} ppm'),
        ('lost force samples', str(report['lost'])),
        ('forces marked as not valid', str(report['invalid'])),
        ('dropped inside nodes', str(report['dropped'])),
        ('simulated time stopped for a slow host', f'{report["waited_s"]:.2f} s'),
    ]
    title = 'Measured on the virtual sensor (simulated)'
    console.print(make_table(title, ('figure', 'value'), rows))
    if report['refused']:
        console.print(f'no error and no figure: {report["refused"]}', soft_wrap=True)
    else:
        console.print(f'figure   {folder / "demo.png"}', soft_wrap=True)
    console.print(f'bag      {folder / BAG}', soft_wrap=True)
    console.print(f'summary  {folder / "demo.json"}', soft_wrap=True)
