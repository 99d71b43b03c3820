# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The commands `train` and `evaluate`; torch is imported only when one of them runs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from mixtac.options import JsonFile, Preset, ReferenceTopic
from mixtac_core.node.files import writable, write_json
from mixtac_core.node.topics import REFERENCE
from mixtac_fger.weights import DEFAULT_MODEL, find_model, read_model
from mixtac_learning.train.config import read_run_config, with_overrides
from mixtac_sim.world.plans import TRAINING_PRESET, unseen_devices

ModelFile = Annotated[str, typer.Option('--model', help='Weight file, or name of a shipped model.')]


def train(
    config: Annotated[
        str,
        typer.Argument(
            help='YAML file, or a shipped one: ours, fger_paper, frames, events, fusion, smoke.'
        ),
    ] = 'ours',
    bags: Annotated[
        list[Path] | None,
        typer.Option(help='Bags, or folder of bags, instead of the data named in the file.'),
    ] = None,
    start: Annotated[
        str | None,
        typer.Option(help='Weight file, or name of a shipped model, to adapt to the bags.'),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help='Weight file to write.', callback=writable)
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(min=0, help='Random seed for initial weights and shuffling.'),
    ] = None,
    jobs: Annotated[int, typer.Option(min=1, help='Number of processes that prepare data.')] = 2,
    data: Annotated[Path | None, typer.Option(help='Folder of prepared samples.')] = None,
    folder: Annotated[
        Path | None,
        typer.Option(
            help='Folder of checkpoint and curves; an interrupted run is resumed from it.'
        ),
    ] = None,
    json: JsonFile = None,
) -> None:
    """Train a network as a YAML file describes.

    With --start, training of the small network continues from trained weights. One fifth of the
    trials is held out; the errors on it before and after training are printed. Processes started
    by torchrun share the work.
    """
    from mixtac_learning.train.run import run_training

    chosen = with_overrides(read_run_config(config), out, seed, data, bags or (), start)
    run_training(chosen, folder, jobs, json)


def evaluate(
    bags: Annotated[
        list[Path] | None,
        typer.Argument(help='Bags or folders of bags; without any, simulated trials are used.'),
    ] = None,
    model: ModelFile = DEFAULT_MODEL,
    seed: Annotated[
        int, typer.Option(min=2, help='Random seed for the simulated sensors and trials.')
    ] = 2,
    gels: Annotated[int, typer.Option(min=1, help='Number of simulated sensors.')] = 3,
    seconds: Annotated[float, typer.Option(min=4, help='Length of a trial (s).')] = 10.0,
    preset: Preset = TRAINING_PRESET,
    reference: ReferenceTopic = REFERENCE,
    figures: Annotated[
        Path | None, typer.Option('--figure', help='Image file for the plots.', callback=writable)
    ] = None,
    series: Annotated[
        Path | None,
        typer.Option(
            help='CSV file for forces over time, with deviation, validity and reference.',
            callback=writable,
        ),
    ] = None,
    json: JsonFile = None,
) -> None:
    """Evaluate a model on bags, or on simulated sensors that no training has used."""
    from mixtac_learning.judge import report
    from mixtac_learning.judge.estimators import trial_estimator

    path = find_model(model)
    content: dict[str, Any] = {'model': str(path)}
    trained = read_model(path)
    if bags:
        estimates, found = report.judge_bags(trained, bags, reference)
    else:
        estimator, devices = trial_estimator(trained), unseen_devices(gels, seed)
        estimates, found = report.judge_devices(estimator, devices, seconds, seed, preset)
        content['simulated'] = {'gels': gels, 'seconds': seconds, 'seed': seed, 'preset': preset}
    title = f'{path.name} on {len(estimates)} {"bags" if bags else "simulated trials"}'
    report.show_figures(title, *found['metrics'].values())
    report.show_skipped(found['skipped'])
    if figures is not None:
        report.draw_trials(figures, title, estimates)
        print(f'drawn: {figures}')
    if series is not None:
        report.write_series(series, estimates)
        print(f'written: {series}')
    write_json(json, found | content)
