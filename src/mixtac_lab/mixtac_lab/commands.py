# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The commands `mixtac bench` and `mixtac experiments`.

Both groups are entry points of `mixtac.commands`. Importing this module is cheap: an experiment
or a benchmark, and the compiled code and torch that it needs, is imported when it is run.
"""

from __future__ import annotations

import datetime as dt
import os
import platform
import sys
import time
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, List, Optional  # noqa: UP035

import typer

from mixtac_events.errors import MixtacError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rich.console import Console

    from mixtac_lab.experiments.harness import Context, Outcome


class ExperimentError(MixtacError):
    """An experiment that does not exist or cannot be carried out."""


NAMES = (
    'vibration',
    'stability',
    'inputs',
    'fusion',
    'impact',
    'slip',
    'model',
    'comparison',
)
"""In the order of the paper."""
ALL = 'all'


def chosen(names: Sequence[str]) -> tuple[str, ...]:
    """Return the experiments that some names mean, each once, in the order of the paper.

    Raises:
        ExperimentError: There is no such experiment.
    """
    unknown = sorted(set(names) - {*NAMES, ALL})
    if unknown:
        raise ExperimentError(
            f'experiment {unknown[0]!r} is unknown: choose of {", ".join(NAMES)}, or {ALL}'
        )
    return NAMES if ALL in names else tuple(name for name in NAMES if name in names)


def carry_out_experiment(name: str, context: Context) -> Outcome:
    """Carry an experiment out.

    Raises:
        MixtacError: It cannot be.
    """
    module = import_module(f'mixtac_lab.experiments.paper.{name}')
    outcome: Outcome = getattr(module, name)(context)
    return outcome


# typer evaluates these under Python 3.10.
OptionalPath = Optional[Path]  # noqa: UP045
OptionalStrings = Optional[List[str]]  # noqa: UP006, UP045
EXPERIMENT_HELP = {
    'vibration': 'Tones of 50 to 450 Hz: which frequency the events show.',
    'stability': 'Long holds: whether the error grows within 25 s.',
    'inputs': 'Frames, events, or both, on dynamic forces.',
    'fusion': 'FGER-Net against feature-level fusion, on static forces.',
    'impact': '20 g from 5 cm: impact, bounces and hold.',
    'slip': 'Objects that are struck, in closed loop.',
    'model': 'Parameters, operations and latency of the networks.',
    'comparison': 'Rate, error and range beside other sensors.',
    ALL: 'All eight experiments of the paper.',
}


@dataclass(frozen=True, slots=True)
class Request:
    """What was asked for.

    Attributes:
        names: Experiments, `all` for all.
        quick: In minutes.
        json: File for the numbers.
        out: Folder of report and all that is kept.
        bags: Folder of recordings; None to simulate.
        seeds: Number of seeds; 0 for one (quick) or three.
        jobs: Processes; 0 for as many as there are cores.
    """

    names: tuple[str, ...]
    quick: bool
    json: Path | None
    out: Path | None
    bags: Path | None
    seeds: int
    jobs: int


def _command(name: str) -> Callable[..., None]:
    def experiment(
        more: Annotated[OptionalStrings, typer.Argument(help='More experiments.')] = None,
        quick: Annotated[
            bool, typer.Option('--quick', help='Minutes; figures mean nothing.')
        ] = False,
        json: Annotated[OptionalPath, typer.Option(help='Write the numbers there as well.')] = None,
        out: Annotated[
            OptionalPath, typer.Option(help='Folder; a run that was cut off goes on there.')
        ] = None,
        bags: Annotated[
            OptionalPath,
            typer.Option(
                exists=True, file_okay=False, help='Your recordings; docs/experiments.md.'
            ),
        ] = None,
        seeds: Annotated[int, typer.Option(min=0, help='0: three, or one if quick.')] = 0,
        jobs: Annotated[int, typer.Option(min=0, help='Processes; 0: one per core.')] = 0,
    ) -> None:
        from rich.console import Console

        names = chosen([name, *(more or [])])
        run_experiments(Console(), Request(names, quick, json, out, bags, seeds, jobs))

    experiment.__doc__ = EXPERIMENT_HELP[name]
    return experiment


vibration = _command('vibration')
stability = _command('stability')
inputs = _command('inputs')
fusion = _command('fusion')
impact = _command('impact')
slip = _command('slip')
model = _command('model')
comparison = _command('comparison')
all_experiments = _command(ALL)


def run_experiments(console: Console, request: Request) -> list[Outcome]:
    """Carry experiments out and write the report.

    Args:
        console: Where progress and numbers go.
        request: What to do.

    Raises:
        MixtacError: One cannot be carried out; what was finished is kept.
    """
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    from mixtac_lab.experiments.harness import Context
    from mixtac_lab.experiments.report import write_html, write_json, write_markdown
    from mixtac_lab.experiments.sizes import FULL, QUICK

    sizes = QUICK if request.quick else FULL
    where = f'experiments_{sizes.name}' + ('' if request.bags is None else '_bags')
    folder = request.out or Path('runs') / where
    folder.mkdir(parents=True, exist_ok=True)
    started = time.monotonic()
    columns = (TextColumn('{task.description}'), BarColumn(), MofNCompleteColumn())
    with Progress(*columns, TimeElapsedColumn(), console=console) as progress:
        context = Context(
            sizes,
            folder,
            request.seeds or (1 if request.quick else 3),
            request.jobs or os.cpu_count() or 1,
            request.bags,
            progress,
        )
        outcomes = [_carry_out(name, context, len(request.names)) for name in request.names]
    told = _told(request, context, time.monotonic() - started)
    write_html(folder / 'report.html', outcomes, told)
    write_markdown(folder / 'report.md', outcomes)
    for path in (folder / 'report.json', *([request.json] if request.json else [])):
        write_json(path, outcomes, told)
    _print(console, outcomes)
    console.print(f'report: {folder / "report.html"}')
    return outcomes


def _carry_out(name: str, context: Context, among: int) -> Outcome:
    """Return an outcome; of several, one whose recordings are missing is left out by name."""
    from mixtac_lab.experiments.harness import Outcome
    from mixtac_recordings.recording import RecordingError

    try:
        return carry_out_experiment(name, context)
    except RecordingError as error:
        if context.bags is None or among == 1:
            raise
        return Outcome(name, name.capitalize(), '-', context.bags.name, skipped=str(error))


def _told(request: Request, context: Context, seconds: float) -> dict[str, Any]:
    from mixtac_lab.store import sensor_digest

    words = ' '.join(Path(word).name if '/' in word else word for word in sys.argv[1:])
    return {
        'command': f'./mixtac {words}',
        'experiments': ', '.join(request.names),
        'sizes': context.sizes.name,
        'seeds': context.seeds,
        'processes': context.jobs,
        'data': 'virtual sensor (simulated)' if request.bags is None else request.bags.name,
        'simulator': sensor_digest(),
        'machine': f'{os.cpu_count()} cores, {platform.machine()}, Python '
        f'{platform.python_version()}',
        'minutes': f'{seconds / 60:.1f}, without what had been kept from runs before',
        'date': f'{dt.datetime.now(dt.timezone.utc):%Y-%m-%d}',
    }


def _print(console: Console, outcomes: Sequence[Outcome]) -> None:
    from rich.table import Table

    from mixtac_lab.experiments.report import number, value_text

    for outcome in outcomes:
        title = f'{outcome.title}: {outcome.data}'
        if outcome.skipped:
            console.print(f'{outcome.title} not carried out: {outcome.skipped}')
            continue
        table = Table(title=title, title_justify='left')
        for heading in ('what', 'ours', 'paper', 'unit'):
            table.add_column(heading, justify='left' if heading in {'what', 'unit'} else 'right')
        for row in outcome.rows:
            simulated = ', simulated' if row.simulated and row.ours.count else ''
            paper = '' if row.paper is None else number(row.paper)
            table.add_row(row.name + simulated, value_text(row.ours), paper, row.unit)
        console.print(table)
