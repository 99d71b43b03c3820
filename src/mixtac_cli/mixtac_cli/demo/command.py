# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac demo`: the whole path from the virtual camera to the force, shown live and measured."""

from __future__ import annotations

import datetime as dt
import os
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from mixtac_alignment.align import align
from mixtac_alignment.bags import read_recording
from mixtac_alignment.clock_fit import ClockFit
from mixtac_alignment.errors import AlignmentError, InconsistentFitError
from mixtac_cli.calibrate_force.session import LiveProcedure
from mixtac_cli.demo.drawing import draw_run
from mixtac_cli.demo.evaluation import (
    WINDOW_NS,
    compare,
    event_rate,
    frame_jump,
    host_time,
    lost_windows,
    mae,
    mean_rate_hz,
    peak_error,
    phases,
    read_streams,
    truth_mae,
)
from mixtac_cli.demo.sideways import SCENARIO, SECONDS, read_sideways, true_path
from mixtac_cli.monitor_node import Monitor
from mixtac_cli.options import JsonFile, OptionalPath
from mixtac_cli.up import start_nodes
from mixtac_fger.force_calibration import ForceCalibrationError, fit_gain, load_of
from mixtac_node.files import FileError, write_json
from mixtac_node.graph import recorder, sensor_graph
from mixtac_node.process import GraphError, ProcessGroup
from mixtac_node.topics import CONTACT, CONTACT_POINT, DEFAULT_NAMESPACE, Topic

SETTLE_S = 1.0
LEAD_S = 8.0
"""Delay of the scenario after time goes on again."""
SIDEWAYS_LEAD_S = 1.0
"""The same of the second part, in which no latency is measured."""
CLOCK_S = 5.0
"""Time in which the driver finds out that the camera's clock stood still."""
START_UP_S = 60.0
TAIL_S = 1.0
MAX_FORCE_GAP_S = 2.0
"""A busy host may lose reference samples [s]; here their clock is known to be a single one."""
PRESET = 'paper_like'
"""What the shipped model was trained for."""
SIDEWAYS_BAG = 'bag_sideways'
LOADS_G = (30.0, 60.0, 90.0)
"""Known loads by which the demo calibrates the sensor [g]."""
DROP_COUNTERS = {
    'driver': (
        'usb transfers dropped',
        'bytes dropped',
        'frames dropped',
        'imu dropped',
        'external edges dropped',
        'camera dropped',
        'camera dvs dropped',
        'camera external input dropped',
    ),
    'fger': ('frames_dropped',),
    'recorder': ('messages dropped',),
}
"""Diagnostics of each node that count what it received and did not pass on."""


@dataclass(frozen=True)
class Run:
    """What was measured while the graph ran.

    Attributes:
        gain: See `_evaluate`.
        dropped: See `_evaluate`.
        computed_s: See `_evaluate`.
        waited_s: See `_evaluate`.
        host: `host_idle` and `host_stolen` of `_evaluate`.
        clock_pairs: (host, camera) clock pairs [ns] of the scenario, shape (N, 2), int64.
        arrival_ns: Arrival of each force, host clock [ns], int64.
        stamp_ns: Stamp of each force, camera clock [ns], int64.
    """

    gain: float
    dropped: int
    computed_s: float
    waited_s: float
    host: dict[str, float]
    clock_pairs: NDArray[np.int64]
    arrival_ns: NDArray[np.int64]
    stamp_ns: NDArray[np.int64]


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
            min=0, help='Random seed that selects the virtual sensor (beads, gel, lamp, pixels).'
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
    console = Console()
    now = dt.datetime.now().astimezone()
    folder = out or Path('demo_out') / f'{now:%Y%m%d-%H%M%S}'
    _private_domain(console)
    try:
        folder.mkdir(parents=True)
    except OSError as error:
        raise FileError(
            f'cannot create folder {folder}: {error.strerror}', remedy='name a new folder in --out'
        ) from error
    run, failed = _run_graph(console, folder, seconds, seed, device_seed, model)
    console.print('aligning and comparing')
    report = _evaluate(folder, run, seconds, seed, device_seed)
    for path in (folder / 'demo.json', json):
        if path is not None:
            write_json(path, report)
    _print_summary(console, report, folder)
    if failed:
        raise GraphError(f'nodes did not end cleanly: {failed}', remedy=f'see {folder / "log"}')


def _private_domain(console: Console) -> None:
    """Keep the demo apart from other ROS graphs on this machine."""
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    os.environ.setdefault('ROS_DOMAIN_ID', str(1 + os.getpid() % 100))
    console.print(f'ROS_DOMAIN_ID={os.environ["ROS_DOMAIN_ID"]} (for tools in another terminal)')


def _run_graph(
    console: Console, out: Path, seconds: float, seed: int, device_seed: int, model: Path | None
) -> tuple[Run, dict[str, int]]:
    """Run the graph through the scenario, recorded to the folder `bag`.

    Returns:
        What was measured, and the exit status of nodes that did not end cleanly.
    """
    virtual_sensor = {
        'seed': seed,
        'device_seed': device_seed,
        'preset': PRESET,
        'scenario': 'demo',
        'seconds': float(seconds),
        'play_on_start': False,
        'loop': False,
        'lead_seconds': LEAD_S,
        'slow_host': 'wait',
    }
    # A blow saturates the sensor for an instant, and its peak is to be seen.
    estimator = {'invalid_force': 'publish'}
    if model is not None:
        estimator['model'] = str(model.resolve())
    # Less for a slow host to do: packets as long as a window, and no inertial samples.
    driver = {
        'event_message_time_threshold': WINDOW_NS / 1e9,
        'imu_acc_enabled': False,
        'imu_gyro_enabled': False,
        'imu_temp_enabled': False,
        # While the host computes, the camera sends nothing.
        'stream_timeout': 600.0,
    }
    sensor = sensor_graph(
        'virtual', driver=driver, virtual_sensor=virtual_sensor, estimator=estimator
    )
    console.print('starting virtual sensor, driver and estimator')
    with (
        ProcessGroup(out / 'log') as processes,
        Monitor(DEFAULT_NAMESPACE, seconds + SECONDS + START_UP_S) as monitor,
    ):
        start_nodes(processes, sensor)
        monitor.bring_up_all(sensor, processes)
        monitor.listen()
        monitor.wait_for_force(processes.check)
        gain = _calibrate(console, processes, monitor)
        _record(out / 'bag', processes, monitor, exclude=(CONTACT, CONTACT_POINT))
        # Messages in the first half second after discovery are often lost.
        time.sleep(SETTLE_S)
        lost_s = _lost_s(monitor)
        _compute_scenario(console, processes, monitor, plays=1)
        time.sleep(CLOCK_S)
        computed_s = _lost_s(monitor) - lost_s
        first, times, pairs = monitor.force_count, _processor_times(), len(monitor.clock_pairs())
        LiveView(console, monitor).show(LEAD_S - CLOCK_S + seconds + TAIL_S, processes.check)
        host = _shares(_processor_times() - times)
        arrival, stamp, _ = monitor.force()
        waited_s = _lost_s(monitor) - lost_s - computed_s
        run = Run(
            *(gain, _dropped(monitor), computed_s, waited_s, host),
            *(monitor.clock_pairs()[pairs:], arrival[first:], stamp[first:]),
        )
        processes.stop('recorder')
        _pull_and_roll(console, out / SIDEWAYS_BAG, processes, monitor)
        failed = {name: code for name, code in processes.stop().items() if code}
    return run, failed


def _record(
    bag: Path, processes: ProcessGroup, monitor: Monitor, exclude: Sequence[Topic] = ()
) -> None:
    """Start to record to a new bag; return when that has begun."""
    monitor.diagnostics.pop(f'{DEFAULT_NAMESPACE}/recorder', None)
    start_nodes(processes, [recorder(bag, exclude=exclude)])
    while not monitor.values('recorder'):
        time.sleep(0.1)
        processes.check()


def _pull_and_roll(console: Console, bag: Path, processes: ProcessGroup, monitor: Monitor) -> None:
    """Play and record the second part, of which only the sideways force and places count."""
    console.print('a pull sideways and a roll')
    _record(bag, processes, monitor)
    scenario = {'scenario': SCENARIO, 'seconds': SECONDS, 'lead_seconds': SIDEWAYS_LEAD_S}
    monitor.set_parameters('virtual_sensor', scenario, processes.check)
    _compute_scenario(console, processes, monitor, plays=2)
    LiveView(console, monitor).show(SIDEWAYS_LEAD_S + SECONDS + TAIL_S, processes.check)
    processes.stop('recorder')


def _calibrate(console: Console, processes: ProcessGroup, monitor: Monitor) -> float:
    """Calibrate as `mixtac calibrate-force` does; return the gain, 1 if that is refused."""
    console.print('calibrating by known loads, as mixtac calibrate-force does')
    procedure = LiveProcedure(console, DEFAULT_NAMESPACE, 'virtual', yes=True)
    loads = [load_of(grams, 0.0) for grams in LOADS_G]
    try:
        session = procedure.lead(processes, monitor, loads, known=True)
        calibration = fit_gain(session.loads, session.plateaus)
    except ForceCalibrationError as error:
        # As on a host that is too busy; what follows is worth showing all the same.
        console.print(f'not calibrated: {error}', soft_wrap=True)
        monitor.trigger('virtual_sensor/release', processes.check)
        return 1.0
    monitor.set_parameters('fger', {'force_scale': calibration.gain}, processes.check)
    console.print(f'gain {calibration.gain:.3f}', highlight=False)
    return calibration.gain


def _compute_scenario(
    console: Console, processes: ProcessGroup, monitor: Monitor, plays: int
) -> None:
    """Start a scenario, the first or a later one; return when it is computed."""
    monitor.trigger('virtual_sensor/play', processes.check)
    while int(monitor.values('virtual_sensor').get('plays', 0)) < plays:
        time.sleep(0.1)
        processes.check()
    with console.status('computing the scenario') as status:
        while (values := monitor.values('virtual_sensor')).get('computing') == 'True':
            done_s = float(values['ahead_us']) / 1e6
            status.update(f'computing the scenario: {done_s:.0f} s are ready')
            time.sleep(_PERIOD_S)
            processes.check()


def _lost_s(monitor: Monitor) -> float:
    """Return for how long simulated time has stopped so far [s]."""
    return float(monitor.values('virtual_sensor').get('lost_us', 0)) / 1e6


def _processor_times() -> NDArray[np.int64]:
    """Return user, nice, system, idle, wait, two kinds of interrupts and stolen time so far."""
    first, *_ = Path('/proc/stat').read_text(encoding='ascii').splitlines()
    return np.array(first.split()[1:9], np.int64)


def _shares(spent: NDArray[np.int64]) -> dict[str, float]:
    idle, stolen = (spent[[3, 7]] / max(1, spent.sum())).tolist()
    return {'host_idle': idle, 'host_stolen': stolen}


def _dropped(monitor: Monitor) -> int:
    return sum(
        int(float(monitor.values(node).get(key, 0)))
        for node, keys in DROP_COUNTERS.items()
        for key in keys
    )


def _evaluate(out: Path, run: Run, seconds: float, seed: int, device_seed: int) -> dict[str, Any]:
    """Compare the recorded force with the aligned reference, and draw the run.

    Returns:
        The figures for JSON; simulated sensor, real processes and middleware.

        `seconds`: Length of the scenario [s].
        `seed`: Seed of the scenario.
        `device_seed`: Seed of the virtual sensor's build.
        `force_hz`: Rate of `/mixtac/force` at a subscriber in another process.
        `lost`: Force samples missing at that subscriber, by their stamps.
        `invalid`: Force samples marked as not valid; they are published and count in all figures.
        `latency_ms`: From the end of a window to its force at the subscriber, p50 and p99; from the
            arrival of the window's last packet if simulated time stopped (`waited_s`).
        `mae_n`: Mean absolute error against the reference, aligned as by `mixtac align` and less
            its zero; None, as `rmse_n`, `constant_mae_n`, `reference_zero_n` and `clock_drift_ppm`,
            if the alignment was refused.
        `rmse_n`: Root mean square error against the same.
        `mae_uncalibrated_n`: What `mae_n` would be without the calibration.
        `gain`: Factor of the force that the calibration found; 1 if it was refused.
        `peak_error`: Relative error of the peak of the impact; None if it is not known.
        `frame_jump`: Mean change of the force where a frame corrects it over the mean change
            elsewhere.
        `reference_zero_n`: What the reference showed without a load, before and after [N].
        `constant_mae_n`: Error of the best constant guess on the same samples.
        `truth_mae_n`: Mean absolute error against the simulated force itself.
        `event_rate_mev_s`: Mean event rate.
        `peak_event_rate_mev_s`: Highest event rate in 10 ms.
        `packet_hz`: Rate of event packets.
        `lost_packets`: Event packets missing in the recording.
        `computed_s`: Time for which simulated time stopped to compute the scenario [s].
        `waited_s`: Time for which it stopped later, because the host was too slow [s].
        `host_idle`: Part of the host's processor time that nobody used during the scenario.
        `host_stolen`: Part of it that a virtual machine's host gave to others: with more than a
            hundredth, `latency_ms` is the host's and not the graph's.
        `dropped`: Transfers, words, frames and messages dropped inside nodes (`DROP_COUNTERS`).
        `clock_drift_ppm`: Drift of the reference clock found by the alignment.
        `aligned_by`: Method of the alignment, `refined` if the frames agree with the taps.
        `refused`: Why the alignment was refused, or empty.
        `sideways_mae_n`: Mean absolute error per axis of the sideways force against the simulated
            one, in the second part, while it touches; None if it was never known.
        `sideways_size_n`: Mean absolute value of the same force per axis.
        `sideways_peak_n`: Its largest magnitude.
        `sideways_unknown`: Windows of the second part in contact without a sideways force.
    """
    streams = read_streams(out / 'bag', DEFAULT_NAMESPACE)
    comparison, refused = None, ''
    try:
        comparison = compare(streams, _aligned(out / 'bag'))
    except AlignmentError as error:
        refused = str(error)
    pairs = run.clock_pairs if run.waited_s == 0.0 else None
    latency = (run.arrival_ns - host_time(streams, run.stamp_ns, pairs)) / 1e6
    rate = event_rate(streams, comparison)
    shown = phases(seconds, seed)
    path_mm = true_path(seed, PRESET)
    sideways = read_sideways(out / SIDEWAYS_BAG, DEFAULT_NAMESPACE, path_mm)
    report: dict[str, Any] = {
        'seconds': seconds,
        'seed': seed,
        'device_seed': device_seed,
        'force_hz': mean_rate_hz(run.arrival_ns),
        'lost': lost_windows(run.stamp_ns),
        'invalid': streams.invalid,
        'latency_ms': {
            'p50': float(np.quantile(latency, 0.5)),
            'p99': float(np.quantile(latency, 0.99)),
        },
        'mae_n': mae(comparison) if comparison else None,
        'rmse_n': comparison.rmse_n if comparison else None,
        'mae_uncalibrated_n': mae(comparison, 1.0 / run.gain) if comparison else None,
        'gain': run.gain,
        'peak_error': peak_error(comparison, shown) if comparison else None,
        'frame_jump': frame_jump(streams),
        'reference_zero_n': comparison.zeros_n if comparison else None,
        'constant_mae_n': comparison.constant_mae_n if comparison else None,
        'truth_mae_n': truth_mae(streams, pairs),
        'event_rate_mev_s': float(rate[1].mean() / 1e6),
        'peak_event_rate_mev_s': float(rate[1].max() / 1e6),
        'packet_hz': len(streams.complete_us) / (np.ptp(streams.force_ns) / 1e9),
        'lost_packets': streams.lost_packets,
        'computed_s': run.computed_s,
        'waited_s': run.waited_s,
        **run.host,
        'dropped': run.dropped,
        'clock_drift_ppm': comparison.fit.drift_ppm if comparison else None,
        'aligned_by': comparison.fit.method if comparison else None,
        'refused': refused,
        **sideways.figures,
    }
    if comparison is not None:
        title = (
            f'Virtual sensor (simulated), seed {seed}: MAE {report["mae_n"]:.3f} N against the '
            f'aligned reference, {report["force_hz"]:.1f} Hz, {report["lost"]} lost'
        )
        draw_run(out / 'demo.png', comparison, rate, shown, title, sideways)
    return report


def _aligned(bag: Path) -> ClockFit:
    """Return the clock map: refined with the frames, or by the taps alone where these contradict.

    Raises:
        AlignmentError: The taps were not found.
    """
    recording = read_recording(bag)
    try:
        return align(recording, max_gap_s=MAX_FORCE_GAP_S)[0]
    except InconsistentFitError:
        # A simulated clock never jumps; what contradicts is the model of the gel.
        return align(recording, method='two_impulse', max_gap_s=MAX_FORCE_GAP_S)[0]


def _print_summary(console: Console, report: Mapping[str, Any], folder: Path) -> None:
    """Print the results of a demo and where its bag and figure are."""
    table = Table(title='Measured on the virtual sensor (simulated)', title_justify='left')
    table.add_column('figure')
    table.add_column('value', justify='right')
    for name, value in _rows(report):
        table.add_row(name, value)
    console.print(table)
    if report['refused']:
        console.print(
            f'no error against the reference and no figure: {report["refused"]}', soft_wrap=True
        )
    else:
        console.print(f'figure   {folder / "demo.png"}', soft_wrap=True)
    console.print(f'bag      {folder / "bag"}', soft_wrap=True)
    console.print(f'summary  {folder / "demo.json"}', soft_wrap=True)


def _rows(report: Mapping[str, Any]) -> list[tuple[str, str]]:
    latency = report['latency_ms']
    return [
        ('event rate, mean', f'{report["event_rate_mev_s"]:.3f} Mev/s'),
        ('event rate, highest in 10 ms', f'{report["peak_event_rate_mev_s"]:.2f} Mev/s'),
        ('event packets', f'{report["packet_hz"]:.0f} Hz'),
        ('force', f'{report["force_hz"]:.1f} Hz'),
        ('latency p50 / p99', f'{latency["p50"]:.2f} / {latency["p99"]:.2f} ms'),
        (
            'error against the reference, MAE / RMSE',
            f'{_figure(report["mae_n"])} / {_figure(report["rmse_n"])} N',
        ),
        ('  before the calibration, MAE', f'{_figure(report["mae_uncalibrated_n"])} N'),
        ('  best constant guess, MAE', f'{_figure(report["constant_mae_n"])} N'),
        ('error against the simulated force, MAE', f'{report["truth_mae_n"]:.3f} N'),
        ("error of the impact's peak", _percent(report['peak_error'])),
        ('change at frames over change between', _figure(report['frame_jump'], 1)),
        (
            'sideways force, MAE / mean size / largest',
            ' / '.join(_figure(report[f'sideways_{name}_n']) for name in ('mae', 'size', 'peak'))
            + ' N',
        ),
        ('reference clock drift found', f'{_figure(report["clock_drift_ppm"], 1)} ppm'),
        ('lost: force samples', str(report['lost'])),
        ('lost: event packets', str(report['lost_packets'])),
        ('forces marked as not valid', str(report['invalid'])),
        ('dropped inside nodes', str(report['dropped'])),
        ('simulated time stopped for a slow host', f'{report["waited_s"]:.2f} s'),
        (
            'processors of the host idle / taken by others',
            f'{_percent(report["host_idle"], "")} / {_percent(report["host_stolen"], "")}',
        ),
    ]


def _figure(value: float | None, digits: int = 3) -> str:
    return '-' if value is None else f'{value:.{digits}f}'


def _percent(value: float | None, sign: str = '+') -> str:
    return '-' if value is None else f'{100 * value:{sign}.1f} %'


_BLOCKS = ' ▁▂▃▄▅▆▇█'
_HISTORY = 60
_PERIOD_S = 0.2
_PLAIN_PERIOD_S = 2.0


class LiveView:
    """Shows rates and forces: a table in a terminal, a line every two seconds elsewhere.

    Args:
        console: Where to show it.
        monitor: Source of the figures.
    """

    def __init__(self, console: Console, monitor: Monitor) -> None:
        self._console = console
        self._monitor = monitor
        self._estimates: deque[float] = deque(maxlen=_HISTORY)
        self._references: deque[float] = deque(maxlen=_HISTORY)
        self._last = (time.monotonic(), 0, 0)
        self._rates = (0.0, 0.0)

    def show(self, seconds: float, check: Callable[[], None]) -> None:
        """Show for some seconds and until the scenario has ended.

        Args:
            seconds: At least so long [s].
            check: Called repeatedly; may raise to end it.
        """
        end = time.monotonic() + seconds
        terminal = self._console.is_terminal
        period_s = _PERIOD_S if terminal else _PLAIN_PERIOD_S
        due = time.monotonic() + period_s
        table = Live(self._table(0.0), console=self._console, refresh_per_second=5)
        with table if terminal else nullcontext():
            while (left := end - time.monotonic()) > 0 or self._playing():
                time.sleep(min(_PERIOD_S, max(left, _PERIOD_S / 2)))
                check()
                if time.monotonic() < due:
                    continue
                due += period_s
                self._sample()
                if terminal:
                    table.update(self._table(left))
                else:
                    self._console.print(self._line(left), soft_wrap=True)

    def _line(self, left: float) -> str:
        shown = f'{left:5.1f} s left' if left > 0.0 else 'still playing'
        return (
            f'{shown}  force {self._estimates[-1]:7.3f} N  reference {self._references[-1]:7.3f} N'
            f'  {self._rates[0]:5.0f} Hz  {self._events()}'
        )

    def _playing(self) -> bool:
        # On a slow host simulated time stops now and then, and the scenario takes longer.
        return self._monitor.values('virtual_sensor').get('playing') == 'True'

    def _sample(self) -> None:
        now, monitor = time.monotonic(), self._monitor
        forces, references = monitor.force_count, monitor.reference_count
        then, old_forces, old_references = self._last
        span = max(now - then, 1e-6)
        self._rates = ((forces - old_forces) / span, (references - old_references) / span)
        self._last = (now, forces, references)
        _, _, force = monitor.force()
        self._estimates.append(float(force[-1]) if len(force) else float('nan'))
        self._references.append(monitor.reference_n)

    def _events(self) -> str:
        values = self._monitor.values('driver')
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
