# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The command `mixtac simulate`."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Optional

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from mixtac_recordings.recording import BagError

if TYPE_CHECKING:
    from mixtac_recordings.dataset import DatasetDescription


OptionalPath = Optional[Path]  # noqa: UP045  (typer evaluates this under Python 3.10)


def simulate(
    profile: Annotated[
        str, typer.Option(help='Force profile: idle, press, dynamic, impact, vibration, ...')
    ] = '',
    dataset: Annotated[
        str,
        typer.Option(
            help='Named data set instead: static, long_term, dynamic, impact, vibration, new_gel.'
        ),
    ] = '',
    trials: Annotated[int, typer.Option(min=1, help='Number of trials of the profile.')] = 10,
    seconds: Annotated[float, typer.Option(min=3, max=3600, help='Length of each trial.')] = 25,
    seed: Annotated[int, typer.Option(min=0, help='Another seed, another sensor and days.')] = 0,
    preset: Annotated[str, typer.Option(help='How hard: easy, paper_like or hard.')] = 'paper_like',
    out: Annotated[
        OptionalPath, typer.Option(help='Folder of the bags; a run that was cut off goes on there.')
    ] = None,
    jobs: Annotated[int, typer.Option(min=0, help='Processes; 0 for one per core.')] = 0,
    backend: Annotated[str, typer.Option(help='loky (this machine) or dask.')] = 'loky',
    scheduler: Annotated[str, typer.Option(help='Address of a running Dask scheduler.')] = '',
    compress: Annotated[
        bool, typer.Option(help='Compress the bags (zstd): half the size, somewhat slower.')
    ] = False,
    preview: Annotated[
        OptionalPath, typer.Option(help='Draw the first trial to this picture.')
    ] = None,
) -> None:
    """Simulate trials: to rosbag2 bags with the live topics and the truth, or to a picture."""
    if bool(profile) == bool(dataset):
        raise typer.BadParameter('give one of --profile and --dataset')
    if out is None and preview is None:
        raise typer.BadParameter('give --out FOLDER, --preview PICTURE or both')
    plan = _description(profile, dataset, trials, seconds, seed, preset)
    console = Console()
    if preview is not None:
        from mixtac_cli.simulate.preview import draw_preview

        draw_preview(plan.trials[0], preview)
        console.print(f'first trial drawn: {preview}')
    if out is not None:
        _generate(console, plan, out, jobs or os.cpu_count() or 1, backend, scheduler, compress)


def _description(
    profile: str, dataset: str, trials: int, seconds: float, seed: int, preset: str
) -> DatasetDescription:
    from mixtac_sim.world.datasets import DATASETS, describe, plan_dataset, plan_profile
    from mixtac_sim.world.effects import preset as check_preset

    check_preset(preset)
    if dataset:
        planned = plan_dataset(dataset, seed, preset)
        split_by = DATASETS[dataset].split_by
    else:
        planned, split_by = plan_profile(profile, trials, seconds, seed, preset), 'trial'
    return describe(dataset or profile, seed, preset, split_by, planned)


def _generate(
    console: Console,
    plan: DatasetDescription,
    out: Path,
    jobs: int,
    backend: str,
    scheduler: str,
    compress: bool,
) -> None:
    from mixtac_sim.bags.generation import generate

    columns = (TextColumn('{task.description}'), BarColumn(), MofNCompleteColumn())
    with Progress(*columns, TimeElapsedColumn(), console=console) as progress:
        task = progress.add_task(f'{plan.name}, {plan.preset}', total=len(plan.trials))
        try:
            written = generate(
                plan,
                out,
                jobs=jobs,
                backend=backend,
                scheduler=scheduler,
                compress=compress,
                on_progress=lambda done, total: progress.update(task, completed=done, total=total),
            )
        except OSError as error:
            raise BagError(f'{out} cannot be written ({error}): choose another') from error
    train, test = (len(plan.split(name)) for name in ('train', 'test'))
    console.print(
        f'{written} bags written, {len(plan.trials)} in {out}: {train} train, {test} test'
    )
