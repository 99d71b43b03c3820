# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac simulate`: simulated trials as rosbag2 bags."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import Progress

from mixtac.options import Preset
from mixtac_sim.bags.trial_bag import generate
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
            help='Named data set to write: static, long_term, dynamic, impact, vibration, new_gel.'
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
    if dataset:
        planned, split_by = plan_dataset(dataset, seed, preset), DATASETS[dataset].split_by
    else:
        planned, split_by = plan_profile(profile, trials, seconds, seed, preset), 'trial'
    plan = describe(dataset or profile, seed, preset, split_by, planned)
    with Progress(console=Console(markup=False)) as progress:
        task = progress.add_task(f'{plan.name}, {plan.preset}', total=len(plan.trials))
        written = generate(
            plan,
            out,
            jobs=jobs or os.cpu_count() or 1,
            compress=compress,
            on_progress=lambda done, total: progress.update(task, completed=done, total=total),
        )
    train, test = (len(plan.split(name)) for name in ('train', 'test'))
    print(f'{written} bags written, {len(plan.trials)} in {out}: {train} train, {test} test')
