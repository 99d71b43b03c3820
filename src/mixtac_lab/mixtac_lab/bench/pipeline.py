# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Age of events at a subscriber in another process, and the highest rate without loss.

Three processes: a virtual camera that sends a pattern over its USB protocol, the driver node as
shipped, and a subscriber. The age of an event is the host time at which its packet arrives at the
subscriber minus the true time at which the camera stamped it.
"""

from __future__ import annotations

import contextlib
import json as json_format
import os
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from mixtac_lab.bench.harness import cpu_s
from mixtac_node.graph import config_file, executable
from mixtac_node.process import JsonProcess

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence


NAMESPACE = 'mixtac_bench'
START_TIMEOUT_S = 30.0
SETTLE_S = 2.0


@dataclass(frozen=True, slots=True)
class Load:
    """What the camera sends.

    Attributes:
        rate: Events per second.
        per_row: Mean events per row.
        frame_interval_us: Time between frames [us], 0 for none.
        reading_interval_us: Time between inertial samples [us], 0 for none.
    """

    rate: float
    per_row: float = 1.0
    frame_interval_us: int = 0
    reading_interval_us: int = 0


@dataclass(frozen=True, slots=True)
class PipelineRun:
    """One run.

    Attributes:
        load: What the camera sent.
        seconds: Length of the measurement [s].
        figures: See `mixtac_lab.bench.harness.Arrivals.summary`.
        camera_stalls: Times that the camera's buffer overflowed.
        driver_cpu: CPU time of the driver over time.
        probe_cpu: CPU time of the subscriber over time.
    """

    load: Load
    seconds: float
    figures: Mapping[str, float]
    camera_stalls: int
    driver_cpu: float
    probe_cpu: float

    @property
    def lost(self) -> int:
        """Events that did not arrive."""
        return int(self.figures['events_lost'])

    @property
    def clean(self) -> bool:
        """Whether everything sent has arrived."""
        nothing = not self.lost and not self.figures['packets_lost'] and not self.camera_stalls
        return nothing and self.figures['periods'] > 0

    def as_dict(self) -> dict[str, Any]:
        """Return the run for JSON."""
        rate = self.load.rate / 1e6
        return {
            'rate_mev_s': rate,
            'seconds': self.seconds,
            **self.figures,
            'camera_stalls': self.camera_stalls,
            'driver_cpu': self.driver_cpu,
            'driver_cpu_per_mev_s': self.driver_cpu / rate,
            'subscriber_cpu': self.probe_cpu,
        }


def run_pipeline(
    load: Load,
    seconds: float,
    parameters: Mapping[str, object] | None = None,
    progress: Callable[[float], None] = lambda _seconds: None,
) -> PipelineRun:
    """Run the three processes and measure.

    Args:
        load: What the camera sends.
        seconds: Length of the measurement [s].
        parameters: Driver parameters that differ from the shipped ones.
        progress: Called now and then with the seconds measured so far.

    Raises:
        GraphError: A process did not start.
    """
    env = dict(os.environ)
    env['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix='mixtac-'))
        socket = str(Path(folder) / 'usb.sock')
        camera = stack.enter_context(JsonProcess('camera', camera_command(load, socket), env))
        pattern = camera.expect('ready', START_TIMEOUT_S)
        module = 'mixtac_lab.bench.programs.arrival_probe_node'
        probe = stack.enter_context(JsonProcess('subscriber', [sys.executable, '-m', module], env))
        probe.expect('ready', START_TIMEOUT_S)
        command = _driver_command(socket, parameters or {})
        driver = stack.enter_context(JsonProcess('driver', command, env))
        first = camera.expect('origin_ns', START_TIMEOUT_S)
        time.sleep(SETTLE_S)
        # A start sets the clock going and then resets it: only the last origin counts.
        origin_ns = camera.latest('origin_ns', first)['origin_ns']
        probe.send(
            topic=f'/{NAMESPACE}/events',
            pattern={
                'origin_ns': origin_ns,
                'period_us': pattern['period_us'],
                'events': pattern['events'],
            },
        )
        began_s, driver_s, probe_s = time.monotonic(), cpu_s(driver), cpu_s(probe)
        while (elapsed_s := time.monotonic() - began_s) < seconds:
            time.sleep(min(0.5, seconds - elapsed_s))
            progress(time.monotonic() - began_s)
        elapsed_s = time.monotonic() - began_s
        driver_s, probe_s = cpu_s(driver) - driver_s, cpu_s(probe) - probe_s
        probe.stop()
        figures = probe.expect('events_lost', START_TIMEOUT_S)
        driver.stop()
        camera.stop()
        stalls = int(camera.expect('periods_lost', START_TIMEOUT_S)['periods_lost'])
    return PipelineRun(load, elapsed_s, figures, stalls, driver_s / elapsed_s, probe_s / elapsed_s)


def camera_command(load: Load, socket: str) -> list[str]:
    """Return the command line of the camera that sends a load on a socket."""
    options = {
        'socket': socket,
        'rate': load.rate,
        'per-row': load.per_row,
        'frame-interval': load.frame_interval_us,
        'reading-interval': load.reading_interval_us,
    }
    flags = [f'--{name}={value}' for name, value in options.items()]
    return [sys.executable, '-m', 'mixtac_lab.bench.programs.pattern_camera', *flags]


def _driver_command(socket: str, parameters: Mapping[str, object]) -> list[str]:
    values = {'device': f'virtual:{socket}', **parameters}
    arguments = [f'{name}:={value}' for name, value in values.items()]
    return [
        *(str(executable('mixtac_driver', 'driver_node')), '--ros-args'),
        *('-r', f'__ns:=/{NAMESPACE}', '--log-level', 'warn'),
        *('--params-file', str(config_file('driver.yaml'))),
        *(part for argument in arguments for part in ('-p', argument)),
    ]


OptionalPath = Optional[Path]  # noqa: UP045  (typer evaluates this under Python 3.10)
AGE_RATE = 1e6
LOSS_RATE = 5e6
SENSOR_RATE = 12e6
"""About what the sensor can deliver at most."""
FRAME_INTERVAL_US = 25_000
READING_INTERVAL_US = 1000
LADDER = (5e6, SENSOR_RATE, 20e6, 30e6, 40e6)
STEP_SECONDS = 10.0


@dataclass(frozen=True, slots=True)
class PipelineReport:
    """All runs.

    Attributes:
        age: At 1 Mev/s.
        loss: At 5 Mev/s.
        ladder: At growing rates with frames and inertial samples, up to the first that lost some.
    """

    age: PipelineRun
    loss: PipelineRun
    ladder: tuple[PipelineRun, ...]

    @property
    def max_rate_mev_s(self) -> float:
        """Greatest rate of the ladder at which nothing was lost [10^6/s], 0 for none."""
        return max((run.load.rate / 1e6 for run in self.ladder if run.clean), default=0.0)

    def as_dict(self) -> dict[str, Any]:
        """Return the report for JSON."""
        return {
            'age_ms': {
                'p50': self.age.figures['age_p50_ms'],
                'p99': self.age.figures['age_p99_ms'],
            },
            'lost': self.loss.lost,
            'max_rate_mev_s': self.max_rate_mev_s,
            'driver_cpu_per_mev_s': self.loss.driver_cpu / (self.loss.load.rate / 1e6),
            'simulated_camera': True,
            'runs': {
                'age': self.age.as_dict(),
                'loss': self.loss.as_dict(),
                'ladder': [run.as_dict() for run in self.ladder],
            },
        }


def measure(
    seconds: float, loss_seconds: float, start: Callable[[str, float], Callable[[float], None]]
) -> PipelineReport:
    """Make all runs.

    Args:
        seconds: Length of the run at 1 Mev/s [s].
        loss_seconds: Length of the run at 5 Mev/s [s].
        start: Called with name and length of each run; returns what is told its progress.
    """
    age = run_pipeline(Load(AGE_RATE), seconds, progress=start('age at 1 Mev/s', seconds))
    loss = run_pipeline(Load(LOSS_RATE), loss_seconds, progress=start('5 Mev/s', loss_seconds))
    ladder: list[PipelineRun] = []
    for rate in LADDER:
        load = Load(
            rate, frame_interval_us=FRAME_INTERVAL_US, reading_interval_us=READING_INTERVAL_US
        )
        name = f'{rate / 1e6:g} Mev/s, frames, IMU'
        ladder.append(run_pipeline(load, STEP_SECONDS, progress=start(name, STEP_SECONDS)))
        if not ladder[-1].clean:
            break
    return PipelineReport(age, loss, tuple(ladder))


def pipeline(
    seconds: Annotated[float, typer.Option(min=2, help='Length of the run at 1 Mev/s (s).')] = 30,
    loss_seconds: Annotated[
        float, typer.Option(min=2, help='Length of the run at 5 Mev/s (s).')
    ] = 60,
    json: Annotated[OptionalPath, typer.Option(help='Write the figures there as well.')] = None,
) -> None:
    """Measure the age of events at a subscriber, losses, and the greatest rate without."""
    console = Console()
    columns = (TextColumn('{task.description}'), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console) as bars:

        def start(name: str, length: float) -> Callable[[float], None]:
            bar = bars.add_task(name, total=length)
            return lambda done: bars.update(bar, completed=done)

        report = measure(seconds, loss_seconds, start)
    runs = (report.age, report.loss, *report.ladder)
    console.print(_table(runs))
    console.print(f'largest rate held without loss: {report.max_rate_mev_s:g} Mev/s')
    if json is not None:
        json.write_text(json_format.dumps(report.as_dict(), indent=2) + '\n')


def _table(runs: Sequence[PipelineRun]) -> Table:
    table = Table(
        title='Events of a simulated camera at a subscriber in another process',
        title_justify='left',
    )
    headings = ('Mev/s', 'with frames', 's', 'age p50 ms', 'p99 ms', 'max ms', 'events lost')
    for heading in (*headings, 'driver CPU', 'subscriber CPU'):
        table.add_column(heading, justify='right')
    for run in runs:
        figures = run.figures
        table.add_row(
            f'{run.load.rate / 1e6:g}',
            'yes' if run.load.frame_interval_us else 'no',
            f'{run.seconds:.0f}',
            f'{figures["age_p50_ms"]:.2f}',
            f'{figures["age_p99_ms"]:.2f}',
            f'{figures["age_max_ms"]:.1f}',
            f'{run.lost}' if not run.camera_stalls else f'{run.lost} + camera',
            f'{100 * run.driver_cpu:.0f} %',
            f'{100 * run.probe_cpu:.0f} %',
        )
    return table
