# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""How an experiment becomes a command, and how commands run experiments and report them.

An experiment is a function that takes a `Context` and returns an `Outcome`: rows that set our
values beside the values of the paper, figures, and a list of differences from the paper.
"""

from __future__ import annotations

import datetime as dt
import importlib
import os
import platform
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, List, Optional  # noqa: UP035

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from mixtac_events.errors import MixtacError
from mixtac_learning.commands import JsonFile, OptionalPath
from mixtac_learning.experiments import EXPERIMENTS, report, sizes
from mixtac_learning.experiments.report import Outcome
from mixtac_learning.experiments.sizes import Sizes
from mixtac_learning.experiments.store import Piece, compute
from mixtac_recordings.recording import RecordingError
from mixtac_sim.world.training_trials import simulator_digest

# typer evaluates these under Python 3.10.
OptionalStrings = Optional[List[str]]  # noqa: UP006, UP045
ALL = 'all'
NO_EXPERIMENTS = {ALL, 'models'}
"""Commands that are no experiment of the paper."""


class ExperimentError(MixtacError):
    """An experiment that does not exist, or that cannot be run."""


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
    """

    sizes: Sizes
    folder: Path
    seeds: int
    jobs: int
    bags: Path | None
    progress: Progress

    @property
    def pieces(self) -> Path:
        """Folder of the stored results."""
        return self.folder / 'pieces'

    def figure(self, name: str) -> Path:
        """Return the path of a figure."""
        return self.folder / 'figures' / f'{name}.png'

    def run(self, title: str, pieces: Sequence[Piece]) -> list[dict[str, Any]]:
        """Return the results of pieces of work and show a progress bar meanwhile.

        Raises:
            MixtacError: A piece failed.
        """
        bar = self.progress.add_task(title, total=len(pieces))
        return compute(self.pieces, pieces, self.jobs, lambda: self.progress.advance(bar))


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
        chosen = select([name, *(more or [])])
        run_experiments(
            Console(markup=False),
            chosen,
            quick=quick,
            json=json,
            out=out,
            bags=bags,
            seeds=seeds,
            jobs=jobs,
        )

    command.__name__, command.__doc__ = name, text
    return command


all_experiments = make_command(ALL, 'Run all experiments of the paper.')


def select(names: Sequence[str]) -> dict[str, Callable[[Context], Outcome]]:
    """Return experiments by name, each once, in the order of the paper.

    Args:
        names: Names of experiments; `all` stands for all of them.

    Raises:
        ExperimentError: There is no such experiment.
    """
    places = {name: EXPERIMENTS[name] for name in EXPERIMENTS if name not in NO_EXPERIMENTS}
    unknown = sorted(set(names) - {*places, ALL})
    if unknown:
        raise ExperimentError(
            f'unknown experiment {unknown[0]!r}',
            remedy=f'choose from {", ".join(sorted(places))}, or {ALL}',
        )
    found = {}
    for name, place in places.items():
        if ALL in names or name in names:
            module, _, function = place.partition(':')
            found[name] = getattr(importlib.import_module(module), function).run
    return found


def run_experiments(
    console: Console,
    chosen: Mapping[str, Callable[[Context], Outcome]],
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
        chosen: Experiments by name, from `select`.
        quick: Use the sizes that need minutes only.
        json: Another file for the results.
        out: Folder of the report; None for one below `runs`.
        bags: Folder of recordings; None to simulate.
        seeds: Number of seeds; 0 for the default.
        jobs: Number of processes; 0 for one per core.

    Raises:
        MixtacError: An experiment failed; finished pieces stay stored.
    """
    size = sizes.QUICK if quick else sizes.FULL
    folder = out or Path('runs') / f'experiments_{size.name}{"" if bags is None else "_bags"}'
    seeds, jobs = seeds or (1 if quick else 3), jobs or os.cpu_count() or 1
    started, outcomes = time.monotonic(), []
    columns = (TextColumn('{task.description}'), BarColumn(), MofNCompleteColumn())
    with Progress(*columns, TimeElapsedColumn(), console=console) as progress:
        context = Context(size, folder, seeds, jobs, bags, progress)
        for name, run in chosen.items():
            try:
                outcomes.append(run(context))
            except RecordingError as error:
                # Of several experiments, one without its recordings is skipped.
                if bags is None or len(chosen) == 1:
                    raise
                skipped = Outcome(name, name.capitalize(), '-', bags.name, skipped=str(error))
                outcomes.append(skipped)
    report.write(folder, outcomes, _describe(list(chosen), context, started), json)
    report.show(console, outcomes)
    console.print(f'report: {folder / "report.md"}')
    return outcomes


def _describe(names: Sequence[str], context: Context, started: float) -> dict[str, Any]:
    """Return the description of a run for its report."""
    options = ['--quick'] if context.sizes.name == 'quick' else []
    options += [f'--seeds {context.seeds}', f'--out {context.folder.name}']
    options += [] if context.bags is None else [f'--bags {context.bags.name}']
    minutes = (time.monotonic() - started) / 60
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
        'minutes': f'{minutes:.1f}, without results that were stored before',
        'date': f'{dt.datetime.now(dt.timezone.utc):%Y-%m-%d}',
    }
