# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What an experiment receives and returns, how it becomes a command, and how commands run it.

An experiment is a function that takes a `Context` and returns an `Outcome`: rows that set our
values beside the values of the paper, figures, and a list of differences from the paper. To add
one, decorate the function with `experiment`, and name it in `EXPERIMENTS` and in the table of
commands (`mixtac_cli.main`).
"""

from __future__ import annotations

import datetime as dt
import importlib
import os
import platform
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, List, Optional  # noqa: UP035

import numpy as np
import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from mixtac_cli.options import JsonFile, OptionalPath
from mixtac_events.errors import MixtacError
from mixtac_lab.experiments import report, sizes
from mixtac_lab.experiments.report import Outcome, Row, Value
from mixtac_lab.experiments.sizes import Sizes
from mixtac_lab.store import Piece, Store
from mixtac_learning.judge.estimators import TrialEstimate
from mixtac_learning.judge.metrics import Metrics, measure, peak_error
from mixtac_recordings.recording import RecordingError
from mixtac_sim.world.plans import simulator_digest

# typer evaluates these under Python 3.10.
OptionalStrings = Optional[List[str]]  # noqa: UP006, UP045


class ExperimentError(MixtacError):
    """An experiment that does not exist, or that cannot be run."""


def pooled(estimates: Sequence[TrialEstimate]) -> Metrics:
    """Return the errors of all windows of some trials together."""
    known = np.concatenate([each.known for each in estimates])
    return measure(known, np.concatenate([each.force for each in estimates]))


def error_rows(
    name: str,
    by_seed: Mapping[int, Sequence[TrialEstimate]],
    paper: Mapping[str, float],
    place: str,
    conditions: str,
    *,
    simulated: bool,
) -> list[Row]:
    """Return MAE, RMSE and R2 of a model; one value per seed.

    Args:
        name: Display name of the model.
        by_seed: Its estimates by seed.
        paper: The paper's values by `mae`, `rmse`, `r2`, where it gives them.
        place: Section, figure or table of the paper.
        conditions: Which trials these are.
        simulated: Whether the data are simulated.
    """
    metrics = [pooled(estimates) for estimates in by_seed.values()]
    return [
        Row(
            f'{name}: {title}',
            Value.of(getattr(each, key) for each in metrics),
            paper.get(key),
            place if key in paper else '',
            unit,
            conditions,
            simulated,
        )
        for key, title, unit in (('mae', 'MAE', 'N'), ('rmse', 'RMSE', 'N'), ('r2', 'R2', ''))
    ]


def constant_row(
    by_seed: Mapping[int, Sequence[TrialEstimate]], conditions: str, *, simulated: bool
) -> Row:
    """Return the MAE of the best constant, which any sensor must beat."""
    values = Value.of(pooled(estimates).constant_mae for estimates in by_seed.values())
    return Row('best constant: MAE', values, None, '', 'N', conditions, simulated)


def peak_row(
    name: str,
    by_seed: Mapping[int, Sequence[TrialEstimate]],
    conditions: str,
    *,
    simulated: bool,
) -> Row:
    """Return the mean relative error at the largest force of each trial."""
    values = Value.of(
        float(np.mean([peak_error(e.known, e.force, interval_s(e)) for e in estimates]))
        for estimates in by_seed.values()
    )
    return Row(f'{name}: error of the peak', values, None, '', '', conditions, simulated)


def interval_s(estimate: TrialEstimate) -> float:
    """Return the time between estimates [s]."""
    return 1e-6 * float(np.median(np.diff(estimate.t_us)))


def rate_hz(estimates: Sequence[TrialEstimate]) -> float:
    """Return the number of distinct forces per second [Hz]."""
    changes = sum(int(np.count_nonzero(np.diff(e.force))) for e in estimates)
    return changes / sum(1e-6 * float(e.t_us[-1] - e.t_us[0]) for e in estimates)


@dataclass(frozen=True, slots=True)
class Context:
    """A run of experiments.

    Attributes:
        sizes: How much to compute.
        folder: Folder of the report; what is stored lies below it.
        seeds: Number of seeds; each is another training and, simulated, another sensor.
        jobs: Number of processes.
        bags: Folder of the user's recordings; None to simulate.
        progress: Shows progress bars.
        store: Results that are stored; by default in the folder `pieces`.
    """

    sizes: Sizes
    folder: Path
    seeds: int
    jobs: int
    bags: Path | None
    progress: Progress
    store: Store = field(init=False)

    def __post_init__(self) -> None:
        """Open the store."""
        object.__setattr__(self, 'store', Store(self.folder / 'pieces'))

    @property
    def figures(self) -> Path:
        """Folder of the figures; made on first use."""
        folder = self.folder / 'figures'
        folder.mkdir(parents=True, exist_ok=True)
        return folder

    def run(self, title: str, pieces: Sequence[Piece]) -> list[dict[str, Any]]:
        """Return the results of pieces of work and show a progress bar meanwhile.

        Raises:
            MixtacError: A piece failed.
        """
        bar = self.progress.add_task(title, total=len(pieces))
        return self.store.run(pieces, self.jobs, lambda: self.progress.advance(bar))


def experiment(function: Callable[[Context], Outcome]) -> Callable[..., None]:
    """Make a function `Context -> Outcome` a command with options.

    The name of the function is the name of the experiment, its docstring the help of the command.
    """
    command = make_command(function.__name__, function.__doc__)
    command.run = function  # type: ignore[attr-defined]
    return command


def make_command(name: str, text: str | None) -> Callable[..., None]:
    """Return the command that runs an experiment, or all for the name `all`."""

    def command(
        more: Annotated[OptionalStrings, typer.Argument(help='More experiments.')] = None,
        quick: Annotated[
            bool, typer.Option('--quick', help='Takes minutes; the results mean nothing.')
        ] = False,
        json: JsonFile = None,
        out: Annotated[
            OptionalPath,
            typer.Option(help='Output folder; an interrupted run continues there.'),
        ] = None,
        bags: Annotated[
            OptionalPath,
            typer.Option(
                exists=True,
                file_okay=False,
                help='Folder of your recordings; see docs/experiments.md.',
            ),
        ] = None,
        seeds: Annotated[
            int, typer.Option(min=0, help='Number of seeds; 0: three, or one with --quick.')
        ] = 0,
        jobs: Annotated[int, typer.Option(min=0, help='Number of processes; 0: one per core.')] = 0,
    ) -> None:
        run_experiments(
            Console(markup=False),
            select([name, *(more or [])]),
            quick=quick,
            json=json,
            out=out,
            bags=bags,
            seeds=seeds,
            jobs=jobs,
        )

    command.__name__, command.__doc__ = name, text
    return command


ALL = 'all'
PLACE = 'mixtac_lab.experiments'
EXPERIMENTS = {
    'vibration': 'paper.vibration',
    'stability': 'paper.forces',
    'inputs': 'paper.forces',
    'fusion': 'paper.forces',
    'impact': 'paper.forces',
    'slip': 'paper.slip',
    'model': 'paper.model',
    'comparison': 'paper.comparison',
}
"""Module of each experiment of the paper, in the order of `mixtac experiments all`."""


all_experiments = make_command(ALL, 'Run all experiments of the paper.')


def select(names: Sequence[str]) -> dict[str, Any]:
    """Return the commands of experiments by name, each once, in the order of the paper.

    Args:
        names: Names of experiments; `all` stands for all of them.

    Raises:
        ExperimentError: There is no such experiment.
    """
    unknown = sorted(set(names) - {*EXPERIMENTS, ALL})
    if unknown:
        raise ExperimentError(
            f'unknown experiment {unknown[0]!r}',
            remedy=f'choose from {", ".join(sorted(EXPERIMENTS))}, or {ALL}',
        )
    chosen = [name for name in EXPERIMENTS if ALL in names or name in names]
    return {
        name: getattr(importlib.import_module(f'{PLACE}.{EXPERIMENTS[name]}'), name)
        for name in chosen
    }


def run_experiments(
    console: Console,
    commands: Mapping[str, Any],
    *,
    quick: bool = False,
    json: Path | None = None,
    out: Path | None = None,
    bags: Path | None = None,
    seeds: int = 0,
    jobs: int = 0,
) -> list[Outcome]:
    """Run experiments and write the report.

    Args:
        console: Shows progress and results.
        commands: Experiments by name, as `select` returns them.
        quick: Take the sizes that need minutes only.
        json: Another file for the results.
        out: Folder of the report; None for one below `runs`.
        bags: Folder of recordings; None to simulate.
        seeds: Number of seeds; 0 for the default.
        jobs: Number of processes; 0 for one per core.

    Raises:
        MixtacError: An experiment failed; finished pieces stay stored.
    """
    chosen = sizes.QUICK if quick else sizes.FULL
    where = f'experiments_{chosen.name}' + ('' if bags is None else '_bags')
    folder = out or Path('runs') / where
    started = time.monotonic()
    columns = (TextColumn('{task.description}'), BarColumn(), MofNCompleteColumn())
    with Progress(*columns, TimeElapsedColumn(), console=console) as progress:
        context = Context(
            chosen,
            folder,
            seeds or (1 if quick else 3),
            jobs or os.cpu_count() or 1,
            bags,
            progress,
        )
        outcomes = [_run_one(*item, context, len(commands)) for item in commands.items()]
    run = _describe(list(commands), context, time.monotonic() - started)
    report.write(folder, outcomes, run, json)
    report.show(console, outcomes)
    console.print(f'report: {folder / "report.md"}')
    return outcomes


def _run_one(name: str, command: Any, context: Context, count: int) -> Outcome:  # noqa: ANN401
    """Return an outcome; of several experiments, one without its recordings is skipped."""
    try:
        outcome: Outcome = command.run(context)
    except RecordingError as error:
        if context.bags is None or count == 1:
            raise
        return Outcome(name, name.capitalize(), '-', context.bags.name, skipped=str(error))
    return outcome


def _describe(names: Sequence[str], context: Context, seconds: float) -> dict[str, Any]:
    """Return the description of a run for its report."""
    options = ['--quick'] if context.sizes.name == 'quick' else []
    options += [f'--seeds {context.seeds}', f'--out {context.folder.name}']
    options += [] if context.bags is None else [f'--bags {context.bags.name}']
    return {
        'command': ' '.join(['./mixtac experiments', *names, *options]),
        'experiments': ', '.join(names),
        'sizes': context.sizes.name,
        'seeds': context.seeds,
        'processes': context.jobs,
        'data': 'virtual sensor (simulated)' if context.bags is None else context.bags.name,
        'simulator': simulator_digest(),
        'machine': f'{os.cpu_count()} cores, {platform.machine()}, Python '
        f'{platform.python_version()}',
        'minutes': f'{seconds / 60:.1f}, without results that were stored before',
        'date': f'{dt.datetime.now(dt.timezone.utc):%Y-%m-%d}',
    }
