# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac demo`: the whole path from the virtual camera to the force, shown live and measured."""

from __future__ import annotations

import datetime as dt
import importlib.util
import os
import time
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, NamedTuple

import numpy as np
import psutil
import typer
from numpy.typing import NDArray
from rich.console import Console

from mixtac.figures import EVENTS, FORCE, REFERENCE, make_table, new_axes, save_figure
from mixtac.options import OptionalPath
from mixtac.up import record_command, sensor_values, show, show_without_ros, start_nodes
from mixtac_core.node import topics
from mixtac_core.node.files import write_json
from mixtac_core.node.graph import sensor_graph
from mixtac_core.node.process import GraphError, ProcessGroup
from mixtac_core.node.topics import DEFAULT_NAMESPACE, stamp_to_ns

if TYPE_CHECKING:
    from mixtac_fger.alignment.clock_fit import ClockFit
    from mixtac_fger.alignment.histories import EventCounts, Recording

SEED: Final = 1001
"""Seed of the scenario unless another is named."""
LEAD_S: Final = 8.0
"""Delay of the scenario after time goes on again [s]."""
TAIL_S: Final = 1.0
"""Time in which what was simulated last reaches the recorder [s]."""
BAG: Final = 'bag'
WINDOW_NS: Final = 2_000_000
"""Time between two forces [ns]."""
RATE_WINDOW_US: Final = 10_000
"""Window in which the events of the figure are counted [us]."""
EDGE_US: Final = 50_000
"""Half a synchronising impulse [us]: the comparison starts and ends with whole impulses."""
NEAR_US: Final = 100_000
"""The rest without a load begins this long after the first impulse [us]."""
FAR_US: Final = 500_000
"""It ends this long after the first impulse [us]; the other rest lies as far before the last."""
HELD_PART: Final = 0.8
"""Part of the largest force of the press above which it is held; this calibrates."""
F64 = NDArray[np.float64]


def demo(
    seconds: Annotated[
        float, typer.Option(min=12, max=3600, help='Length of the scenario (s).')
    ] = 30,
    seed: Annotated[
        int, typer.Option(min=0, help='Random seed for forces, contact point, noise and clocks.')
    ] = SEED,
    model: Annotated[
        OptionalPath, typer.Option(help='Weight file to use instead of the shipped one.')
    ] = None,
    out: Annotated[
        OptionalPath, typer.Option(help='New folder for the bag, the figure and the logs.')
    ] = None,
) -> None:
    """Run the graph on the virtual sensor, show it live, then measure and draw the run."""
    console = Console(markup=False)
    if importlib.util.find_spec('rclpy') is None:
        if out or seed != SEED:
            raise GraphError('--out and --seed need ROS 2', remedy='give neither of them')
        compare_without_ros(console, str(model or ''), seconds)
        return
    folder = out or Path('demo_out') / f'{dt.datetime.now().astimezone():%Y%m%d-%H%M%S}'
    # Apart from other ROS graphs on this machine.
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    domain = os.environ.setdefault('ROS_DOMAIN_ID', str(1 + os.getpid() % 100))
    console.print(f'ROS_DOMAIN_ID={domain} (for tools in another terminal)')
    folder.mkdir(parents=True)
    settings = {'seconds': seconds, 'seed': seed}
    with ProcessGroup(folder / 'log') as processes:
        times = _run_graph(console, processes, folder / BAG, model, settings)
        codes = {**processes.stop('record'), **processes.stop()}
    console.print('aligning and comparing')
    report = settings | times | evaluate(folder, seconds, seed)
    write_json(folder / 'demo.json', report)
    print_summary(console, report, folder)
    if failed := {name: code for name, code in codes.items() if code}:
        raise GraphError(f'nodes did not end cleanly: {failed}', remedy=f'see {folder / "log"}')


def compare_without_ros(console: Console, model: str, seconds: float) -> None:
    """Show the force beside the simulated force, and print the mean absolute error.

    Args:
        console: Where to print.
        model: Weight file or name of a model; empty for the default.
        seconds: Duration from the first force on [s, clock of the sensor].
    """
    forces = np.array(show_without_ros('virtual:demo', model, seconds))
    estimate, true = forces[np.isfinite(forces).all(axis=1)].T
    gain = float(estimate @ true / (estimate @ estimate))
    calibrated_n, error_n = (np.abs(each * estimate - true).mean() for each in (gain, 1.0))
    console.print(
        f'mean absolute error against the simulated force: {error_n:.3f} N;'
        f' {calibrated_n:.3f} N after the gain that fits best, {gain:.2f}\n'
        './mixtac demo of a checkout brings ROS 2, records, calibrates, aligns and draws',
        soft_wrap=True,
    )


def _run_graph(
    console: Console,
    processes: ProcessGroup,
    bag: Path,
    model: Path | None,
    settings: Mapping[str, float],
) -> dict[str, float]:
    """Record the scenario while it is shown.

    Returns:
        Times for JSON [s].

        `first_force_s`: From the start of the command to the first force, with the set-up if
            `./mixtac` did it in the same process.
        `waited_s`: How long simulated time stopped because the host was too slow, from the request
            for the scenario to its end.
    """
    from mixtac.monitor_node import Monitor

    virtual_sensor = {
        **settings,
        'device_seed': 1001,  # no shipped model was trained on this sensor
        'preset': 'paper_like',  # the shipped model was trained for it
        'lead_seconds': LEAD_S,
    }
    # An impact saturates the sensor for an instant, and its peak is to be seen.
    estimator: dict[str, object] = {'invalid_force': 'publish', 'contact': False}
    if model is not None:
        estimator['model'] = str(model.resolve())
    # Less work for a slow host: no contact, packets as long as a window, no inertial samples.
    driver = {
        'event_message_time_threshold': WINDOW_NS / 1e9,
        'imu_acc_enabled': False,
        'imu_gyro_enabled': False,
        'imu_temp_enabled': False,
    }
    nodes = sensor_graph(
        'virtual', driver=driver, virtual_sensor=virtual_sensor, estimator=estimator
    )
    console.print('starting virtual sensor, driver, estimator and recording')
    with Monitor(DEFAULT_NAMESPACE, processes) as monitor:
        processes.start('record', record_command(bag, DEFAULT_NAMESPACE))
        start_nodes(processes, nodes)
        monitor.listen()
        monitor.wait(lambda: monitor.estimate.received > 0, 'the first force')
        # The process began as the script that sets everything up.
        first_s = time.time() - psutil.Process().create_time()
        console.print(f'first force after {first_s:.0f} s')
        sensor = partial(monitor.values, 'virtual_sensor')

        def doing() -> str:
            processes.check()
            if sensor()['playing'] == 'True':
                return 'playing the scenario'
            return 'the scenario starts' if sensor()['plays'] == '0' else ''

        monitor.wait(lambda: 'plays' in sensor() and bag.exists(), 'the recording')
        lost_us = float(sensor()['lost_us'])
        monitor.trigger('virtual_sensor/play')
        show(console, doing, lambda: sensor_values(monitor, reference=True))
        time.sleep(TAIL_S)
        waited_us = float(sensor()['lost_us']) - lost_us
        return {'first_force_s': first_s, 'waited_s': waited_us / 1e6}


class Comparison(NamedTuple):
    """Calibrated estimate against aligned reference, on the camera clock.

    Attributes:
        start_us: Camera clock at time 0 below [us].
        time_s: Sample times [s].
        estimate_n: Calibrated force [N].
        reference_n: Reference force at the same times, less its zero [N].
        figures: Figures of the errors; see `evaluate`.
    """

    start_us: int
    time_s: F64
    estimate_n: F64
    reference_n: F64
    figures: dict[str, float]


def evaluate(out: Path, seconds: float, seed: int) -> dict[str, Any]:
    """Compare the recorded force with the aligned reference, and draw the run.

    Returns:
        The figures for JSON; simulated sensor, real processes and middleware.

        `force_hz`: Rate of `/mixtac/force` at the recorder during the scenario.
        `lost`: Force samples missing at the recorder, by their stamps.
        `gain`: Factor of the force by which the press of the scenario calibrates the sensor.
        `mae_n`: Mean absolute error of the calibrated force against the reference, aligned as by
            `mixtac align` and less its zero, without the press that calibrates.
        `mae_uncalibrated_n`: Mean absolute error of the same samples without the calibration.
        `clock_drift_ppm`: Drift of the reference clock found by the alignment.
        `refused`: Why the alignment was refused, or empty; then gain, errors and drift are
            None.
    """
    # Slow to import; the nodes start first.
    from mixtac_core.recordings.bag import BagFile
    from mixtac_fger.alignment.align import align
    from mixtac_fger.alignment.bags import read_recording
    from mixtac_fger.alignment.clock_fit import AlignmentError

    stamps_ns, force_n = [], []
    with BagFile(out / BAG) as bag:
        for _, received_ns, message in bag.messages(topics.FORCE.resolved(DEFAULT_NAMESPACE)):
            stamps_ns.append((stamp_to_ns(message.header.stamp), received_ns))
            force_n.append(topics.normal_force(message))
    ends_ns, arrivals_ns = np.array(stamps_ns, np.int64).reshape(-1, 2).T
    played = ends_ns > ends_ns[-1] - round(1e9 * (seconds + TAIL_S))
    report: dict[str, Any] = {
        'force_hz': float((played.sum() - 1) * 1e9 / np.ptp(arrivals_ns[played])),
        'lost': int(np.ptp(ends_ns[played]) // WINDOW_NS) + 1 - int(played.sum()),
        **dict.fromkeys(('gain', 'mae_n', 'mae_uncalibrated_n', 'clock_drift_ppm')),
        'refused': '',
    }
    recording = read_recording(out / BAG)
    try:
        # A busy host may lose reference samples; here their clock is known to be a single one.
        fit = align(recording, max_gap_s=2.0)
    except AlignmentError as error:
        return report | {'refused': str(error)}
    forces = ends_ns // 1000, np.array(force_n)
    comparison = compare(recording, *forces, fit, press_s(seconds, seed))
    report |= comparison.figures | {'clock_drift_ppm': fit.drift_ppm}
    title = (
        f'Virtual sensor (simulated), seed {seed}: MAE {report["mae_n"]:.3f} N against the '
        f'aligned reference, {report["force_hz"]:.1f} Hz, {report["lost"]} lost'
    )
    draw_run(out / 'demo.png', comparison, recording.counts, title)
    return report


def compare(
    recording: Recording,
    force_us: NDArray[np.int64],
    force_n: F64,
    fit: ClockFit,
    pressed_s: tuple[float, float],
) -> Comparison:
    """Bring the reference to the camera clock, calibrate by the press, and compare.

    Samples from the first to the last impulse of the fit count, the impulses included. The zero of
    a reference sensor drifts. As on a bench it is measured without a load, before and after;
    between the two it follows a straight line.

    Args:
        recording: Holds the reference.
        force_us: Ends of the windows of the estimated forces, camera clock [us], [N].
        force_n: Estimated normal forces [N], [N].
        fit: Clock fit of the reference.
        pressed_s: Start and end of the press [s], as from `press_s`.
    """
    reference_us = fit.to_camera(recording.force_t_s)
    first_us, last_us = fit.anchors[0].camera_us, fit.anchors[-1].camera_us
    rests = (first_us + NEAR_US, first_us + FAR_US), (last_us - FAR_US, last_us - NEAR_US)
    zeros = [
        recording.force[(reference_us >= start) & (reference_us <= end)].mean()
        for start, end in rests
    ]
    zero = np.interp(reference_us, np.mean(rests, axis=1), zeros)
    start_us = first_us - EDGE_US
    inside = (force_us >= start_us) & (force_us <= last_us + EDGE_US)
    reference = np.interp(force_us[inside], reference_us, recording.force - zero)
    time_s, estimate = (force_us[inside] - start_us) / 1e6, force_n[inside]
    pressed = (time_s >= pressed_s[0]) & (time_s <= pressed_s[1])
    held = pressed & (reference > HELD_PART * reference[pressed].max(initial=0.0))
    # Medians: frames that a busy host drops make the estimate wrong for a part of the press.
    felt = float(np.median(estimate[held])) if held.any() else 0.0
    gain = float(np.median(reference[held])) / felt if felt > 0.0 else 1.0
    rest = reference[~pressed]
    figures = {
        'gain': gain,
        'mae_n': float(np.abs(gain * estimate[~pressed] - rest).mean()),
        'mae_uncalibrated_n': float(np.abs(estimate[~pressed] - rest).mean()),
    }
    return Comparison(start_us, time_s, gain * estimate, reference, figures)


def press_s(seconds: float, seed: int) -> tuple[float, float]:
    """Return start and end of the press of the scenario [s since the start of the comparison].

    Args:
        seconds: Length of the scenario [s].
        seed: Its seed.
    """
    from mixtac_sim.world.profiles import make_profile

    profile = make_profile('demo', seed, seconds, sync=True)
    # After the first impulse: press, hold, release.
    _, press, _, release, *_ = profile.segments
    start_s = profile.sync_s[0] - EDGE_US / 1e6
    return press.start_s - start_s, release.end_s - start_s


def draw_run(path: Path, comparison: Comparison, counts: EventCounts, title: str) -> None:
    """Save a figure of a run: both forces above the event rate.

    Args:
        path: File to write; its suffix gives the format.
        comparison: Estimate and aligned reference.
        counts: Numbers of events.
        title: Title; says that the data are simulated if they are.

    Raises:
        FileError: The file cannot be written.
    """
    figure, (force, events) = new_axes(rows=2, width=11.0, height=6.0)
    time_s = comparison.time_s
    force.plot(time_s, comparison.reference_n, color=REFERENCE, lw=1.4, label='reference')
    force.plot(time_s, comparison.estimate_n, color=FORCE, lw=1.0, label='estimate')
    force.set_title(title, loc='left')
    top_n = max(1.2, 1.3 * float(np.quantile(comparison.reference_n, 0.99)))
    force.set(ylabel='normal force [N]', ylim=(-0.15, top_n))
    force.legend(loc='upper right', ncols=2, frameon=False)
    edges_s = np.arange(0.0, time_s[-1], RATE_WINDOW_US / 1e6)
    ends_us = counts.start_us + counts.width_us * (1 + np.arange(len(counts.counts)))
    at_s = (ends_us - comparison.start_us) / 1e6
    found, _ = np.histogram(at_s, edges_s, weights=counts.counts)
    events.semilogy(
        edges_s[1:], np.maximum(found * 1e6 / RATE_WINDOW_US, 1.0), color=EVENTS, lw=0.8
    )
    events.set(ylabel='events [1/s]', xlabel='camera time [s]')
    for axes in (force, events):
        axes.set_xlim(0.0, time_s[-1])
    save_figure(figure, path)


def print_summary(console: Console, report: Mapping[str, Any], folder: Path) -> None:
    """Print the results of a demo and where its bag and figure are."""

    def n(key: str) -> str:
        return '-' if report[key] is None else f'{report[key]:.3f}'

    rows = [
        ('force', f'{report["force_hz"]:.1f} Hz'),
        ('gain, calibrated by the press', n('gain')),
        ('mean absolute error against the reference', f'{n("mae_n")} N'),
        ('  before the calibration', f'{n("mae_uncalibrated_n")} N'),
        ('drift of the reference clock', f'{n("clock_drift_ppm")} ppm'),
        ('lost force samples', str(report['lost'])),
        ('simulated time stopped for a slow host', f'{report["waited_s"]:.2f} s'),
    ]
    title = 'Measured on the virtual sensor (simulated)'
    console.print(make_table(title, ('figure', 'value'), rows))
    if report['refused']:
        console.print(f'no error and no figure: {report["refused"]}', soft_wrap=True)
    console.print(f'bag, log, demo.json and demo.png are in {folder}', soft_wrap=True)
