# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac bench pipeline`: age of events at a subscriber, losses, and the greatest rate without."""

from __future__ import annotations

import json as json_format
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from mixtac_bringup.benchmark.pipeline import Load, PipelineRun, run_pipeline

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

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
