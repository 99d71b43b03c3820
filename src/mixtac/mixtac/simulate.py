# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac simulate`: simulated trials as rosbag2 bags."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from mixtac.options import Preset
from mixtac_core.recordings.dataset import DatasetDescription
from mixtac_core.recordings.recording import RecordingError
from mixtac_sim.bags.trial_bag import generate
from mixtac_sim.world.effects import preset as find_preset
from mixtac_sim.world.plans import DATASETS, describe, plan_dataset, plan_profile


def simulate(
    out: Annotated[
        Path, typer.Option(help='Folder of the bags; an interrupted run resumes there.')
    ],
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
    seconds: Annotated[float, typer.Option(min=3, max=3600, help='Length of each trial (s).')] = 25,
    seed: Annotated[int, typer.Option(min=0, help='Random seed for sensors and trials.')] = 0,
    preset: Preset = 'paper_like',
    jobs: Annotated[int, typer.Option(min=0, help='Processes; 0 for one per core.')] = 0,
    compress: Annotated[
        bool, typer.Option(help='Compress the bags (zstd): half the size, slightly slower.')
    ] = False,
) -> None:
    """Write simulated trials to rosbag2 bags with the live topics and the truth."""
    if bool(profile) == bool(dataset):
        raise typer.BadParameter('give one of --profile and --dataset')
    plan = _description(profile, dataset, trials, seconds, seed, preset)
    console = Console(markup=False)
    _generate(console, plan, out, jobs or os.cpu_count() or 1, compress)


def _description(
    profile: str, dataset: str, trials: int, seconds: float, seed: int, preset: str
) -> DatasetDescription:
    find_preset(preset)
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
    compress: bool,
) -> None:
    columns = (TextColumn('{task.description}'), BarColumn(), MofNCompleteColumn())
    with Progress(*columns, TimeElapsedColumn(), console=console) as progress:
        task = progress.add_task(f'{plan.name}, {plan.preset}', total=len(plan.trials))
        try:
            written = generate(
                plan,
                out,
                jobs=jobs,
                compress=compress,
                on_progress=lambda done, total: progress.update(task, completed=done, total=total),
            )
        except OSError as error:
            raise RecordingError(f'{out} cannot be written ({error}): choose another') from error
    train, test = (len(plan.split(name)) for name in ('train', 'test'))
    console.print(
        f'{written} bags written, {len(plan.trials)} in {out}: {train} train, {test} test'
    )
