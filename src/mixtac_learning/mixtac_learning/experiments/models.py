# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Train models, run them on simulated test trials, and the tables of all models.

Every force experiment calls `force_outcome`: each model is trained once per seed and runs on the
test trials of one force profile. Weights are stored, and all experiments of a run share weights and
estimates. In the tables, the protocol `paper` splits the trials of one session at random; with
`other_days`, the test trials are from other days of the same sensor.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal

import joblib
import numpy as np
import torch
import typer
from rich.console import Console
from rich.progress import Progress

from mixtac.figures import make_table
from mixtac.options import JsonFile
from mixtac_core.node.files import write_json
from mixtac_fger.config import ConfigError
from mixtac_fger.weights import Model as Weights
from mixtac_fger.weights import read_model, write_model
from mixtac_learning.experiments.harness import (
    NETWORKS,
    PRESET,
    TABLE_SIZES,
    Context,
    Outcome,
    Row,
    Sizes,
    Value,
    code_version,
    run_config,
)
from mixtac_learning.judge.estimators import TrialEstimate, trial_estimator
from mixtac_learning.judge.metrics import by_profile, measure
from mixtac_learning.train.config import OURS, DataConfig, RunConfig, SimulatedData
from mixtac_learning.train.run import recipe_of, train_model, training_sources
from mixtac_learning.trials.samples import prepare
from mixtac_learning.trials.trial import SimulatedSource
from mixtac_sim.world.plans import TrialSpec, session_plan, training_plan

JUDGED = {
    'dynamic': (OURS, 'fger', 'frames', 'events'),
    'static': (OURS, 'fger', 'fusion'),
    'long_term': (OURS, 'fger'),
    'impact': (OURS, 'fger'),
}
"""Networks that are evaluated on each profile."""
Estimates = dict[str, dict[int, list[TrialEstimate]]]
"""Estimates by model and seed."""
PROFILES = tuple(JUDGED)
FIRST_DATA_SEED = 40
"""Data seeds of `mixtac_sim.world.plans`; other ones than those of shipped models."""
FIRST_TEST = 830_000
"""First trial seed of the tests; training uses 100,000 to 200,000."""
CHECKED = 1 / 8
"""Part of the training trials that the best weights are chosen by."""


def training_data(sizes: Sizes, seed: int) -> DataConfig:
    """Return the training trials of the seed's sensor."""
    data = SimulatedData(
        (PRESET,), 1, sizes.trials, sizes.seconds, sizes.mix, FIRST_DATA_SEED + seed
    )
    return DataConfig(simulated=data, checked=CHECKED)


def test_trials(sizes: Sizes, seed: int, profile: str) -> list[TrialSpec]:
    """Return other days of the same sensor."""
    count, seconds = sizes.tests[profile]
    device = training_plan(1, 1, 1.0, FIRST_DATA_SEED + seed, (PRESET,))[0].device_seed
    first = FIRST_TEST + 1000 * seed + 100 * PROFILES.index(profile)
    return [TrialSpec(device, first + k, profile, seconds, PRESET) for k in range(count)]


def describe(sizes: Sizes, profile: str) -> str:
    """Return sizes, preset and seeds of the trials in words."""
    count, seconds = sizes.tests[profile]
    return (
        f'virtual sensor, preset {PRESET}; per seed one sensor, trained on {sizes.trials} trials of'
        f' {sizes.seconds:g} s (data seeds from {FIRST_DATA_SEED}), tested on {count} {profile}'
        f' trials of {seconds:g} s on other days (trial seeds from {FIRST_TEST})'
    )


Case = tuple[str, int]
"""A model and a seed."""


def _train(config: RunConfig) -> Weights:
    """Train, unless the weights are stored; an interrupted training continues."""
    torch.set_num_threads(1)
    folder = Path(config.data.cache).parent / 'runs' / joblib.hash((config, code_version()))
    path = folder / 'model.safetensors'
    if not path.exists():
        write_model(path, train_model(config, folder).model)
    return read_model(path)


def _prepare(context: Context, configs: Sequence[RunConfig]) -> None:
    """Prepare the samples before trainings run side by side, which would prepare them twice."""
    sources = {s.name: s for config in configs for s in training_sources(config.data)}
    recipes = {repr(recipe.facts): recipe for recipe in map(recipe_of, configs)}
    folder = context.folder / 'samples'
    cases = [([source], [*recipes.values()], folder) for source in sources.values()]
    context.run('preparing samples', prepare, cases, stored=False)


def train_and_test(
    context: Context,
    title: str,
    models: Sequence[str],
    data: Callable[[int], DataConfig],
    tests: Callable[[int], Sequence[TrialSpec]],
) -> tuple[dict[Case, Weights], Estimates]:
    """Return trained networks, and their estimates of test trials.

    Args:
        context: The run.
        title: Title of the progress bar.
        models: Names of the networks.
        data: Training trials of a seed.
        tests: Test trials of a seed; a trial of several seeds is simulated once.

    Raises:
        MixtacError: A trial cannot be used.
    """
    cache = str(context.folder / 'samples')
    cases = [(model, seed) for model in models for seed in range(context.seeds)]
    configs = [
        run_config(context.sizes, model, seed, replace(data(seed), cache=cache))
        for model, seed in cases
    ]
    _prepare(context, configs)
    # Each training keeps its own checkpoints.
    trained = context.run('training', _train, [(each,) for each in configs], stored=False)
    weights = dict(zip(cases, trained, strict=True))
    tested: dict[TrialSpec, dict[Case, Weights]] = {}
    for case, weight in weights.items():
        for spec in tests(case[1]):
            tested.setdefault(spec, {})[case] = weight
    found: Estimates = {}
    for result in context.run(f'{title}: testing', _judge, [*tested.items()], stored=False):
        for (model, seed), estimate in result.items():
            found.setdefault(model, {}).setdefault(seed, []).append(estimate)
    return weights, found


def _judge(spec: TrialSpec, models: Mapping[Case, Weights]) -> dict[Case, TrialEstimate]:
    """Estimate a trial, which is simulated once, with each model."""
    torch.set_num_threads(1)
    trial = SimulatedSource(spec).load()
    return {case: trial_estimator(model)(trial) for case, model in models.items()}


@cache
def profile_estimates(context: Context, profile: str) -> Estimates:
    """Return the estimates of the networks of a profile on its test trials; trains what is missing.

    Args:
        context: The run.
        profile: One of `JUDGED`.

    Raises:
        MixtacError: Trials cannot be used.
    """
    return train_and_test(
        context,
        profile,
        JUDGED[profile],
        lambda seed: training_data(context.sizes, seed),
        lambda seed: test_trials(context.sizes, seed, profile),
    )[1]


def force_outcome(
    context: Context, profile: str, found: Estimates, rows: list[Row], figures: dict[str, Path]
) -> Outcome:
    """Return the outcome of an experiment that compares networks on one profile.

    Args:
        context: The run.
        profile: One of `JUDGED`.
        found: Estimates of the networks.
        rows: Rows of the experiment; one of the best constant is added.
        figures: Pictures of the estimates, by caption.
    """
    constant = Value.of(pooled(each)['constant_mae'] for each in found[OURS].values())
    last = Row('best constant: MAE', constant, None, '', 'N', f'{profile} trials')
    return Outcome(describe(context.sizes, profile), [*rows, last], figures)


def pooled(estimates: Sequence[TrialEstimate]) -> dict[str, float]:
    """Return the errors of all windows of some trials together."""
    known = np.concatenate([each.known for each in estimates])
    return measure(known, np.concatenate([each.force for each in estimates]))


def error_rows(
    name: str,
    by_seed: Mapping[int, Sequence[TrialEstimate]],
    paper: Mapping[str, float],
    place: str,
    conditions: str,
) -> list[Row]:
    """Return MAE, RMSE and R2 of a model; one value per seed.

    Args:
        name: Display name of the model.
        by_seed: Its estimates by seed.
        paper: The paper's values by `mae`, `rmse`, `r2`, where it gives them.
        place: Section, figure or table of the paper.
        conditions: Which trials these are.
    """
    metrics = [pooled(estimates) for estimates in by_seed.values()]
    rows = []
    for key, unit in (('mae', 'N'), ('rmse', 'N'), ('r2', '')):
        value = Value.of(each.get(key, math.nan) for each in metrics)
        title = f'{name}: {key.upper()}'
        rows.append(Row(title, value, paper.get(key), place, unit, conditions))
    return rows


def rate_hz(estimates: Sequence[TrialEstimate]) -> float:
    """Return the number of distinct forces per second [Hz]."""
    changes = sum(int(np.count_nonzero(np.diff(e.force))) for e in estimates)
    return changes / sum(1e-6 * float(e.t_us[-1] - e.t_us[0]) for e in estimates)


PROTOCOLS = ('paper', 'other_days')
"""One session of one sensor, its trials split 8:2 at random, as in the paper; or trained on some
days of a sensor and tested on others."""
FIRST_TRIAL = 800_000
"""First trial seed of the tests; training uses 100,000 to 200,000."""
TRAINING = 'training'
COST = 'core_minutes'
FIGURES = (
    *('mae', 'rmse', 'r2', 'constant_mae', 'reference_mae', 'peak_error'),
    *('coverage_68', 'coverage_95', COST),
)


def table_data(sizes: Sizes, protocol: str) -> DataConfig:
    """Return the training trials, the same for every model and seed; one in seven validates."""
    session = sizes.session if protocol == 'paper' else {}
    data = SimulatedData((PRESET,), 1, sizes.trials, sizes.seconds, sizes.mix, session=session)
    return DataConfig(simulated=data, checked=1 / 7)


def test_specs(sizes: Sizes, protocol: str) -> list[TrialSpec]:
    """Return the test trials on the training sensor: of the same session, or other days."""
    if protocol == 'paper':
        return session_plan(sizes.session, 0, PRESET)[1]
    device = training_sources(table_data(sizes, protocol))[0].origin['device_seed']
    return [
        TrialSpec(device, FIRST_TRIAL + 100 * row + column, profile, seconds, PRESET)
        for column, (profile, (count, seconds)) in enumerate(sizes.tests.items())
        for row in range(count)
    ]


def aggregate(found: Estimates, cost: Mapping[str, list[float]]) -> dict[str, Any]:
    """Return mean and standard deviation over the seeds.

    Args:
        found: Estimates of the models.
        cost: Time that the training of each model took, by seed [core minutes].

    Returns:
        model -> column -> figure -> `mean`, `spread`, `seeds`; the spread of one seed is 0.
    """
    table: dict[str, Any] = {}
    for model, by_seed in found.items():
        runs = [
            by_profile(trials) | {TRAINING: {COST: minutes}}
            for trials, minutes in zip(by_seed.values(), cost[model], strict=True)
        ]
        table[model] = {column: {} for column in runs[0]}
        for column, figures in table[model].items():
            for figure in FIGURES:
                value = Value.of(run[column][figure] for run in runs if figure in run[column])
                if value.count:
                    mean, spread = round(value.mean, 4), round(value.spread, 4)
                    figures[figure] = {'mean': mean, 'spread': spread, 'seeds': value.count}
    return table


KINDS = {'dynamic': 'dynamic', 'static': 'static', 'long_term': 'hold', 'impact': 'impact'}
"""Names of the force profiles in the rows."""


def rows_of(table: Mapping[str, Any], protocol: str, size: str) -> list[dict[str, Any]]:
    """Return a row per model: its MAE by kind of trial.

    Args:
        table: From `aggregate`.
        protocol: One of `PROTOCOLS`.
        size: Name of the sizes.

    Returns:
        `model`, `protocol`, `size`, `core_minutes` of its training, and `dynamic`, `static`,
        `hold` and `impact`, each with `mae`, its standard deviation `sd` over the seeds (None of
        one seed) and `seeds`.
    """
    rows = []
    for model, columns in table.items():
        row: dict[str, Any] = {'model': model, 'protocol': protocol, 'size': size}
        row[COST] = columns[TRAINING][COST]['mean']
        for profile, name in KINDS.items():
            found = columns.get(profile, {}).get('mae')
            if found is not None:
                sd = found['spread'] if found['seeds'] > 1 else None
                row[name] = {'mae': found['mean'], 'sd': sd, 'seeds': found['seeds']}
        rows.append(row)
    return rows


def cell(value: dict[str, Any] | None) -> str:
    """Return an error of a row as text, `-` for none."""
    if value is None:
        return '-'
    return f'{value["mae"]:.3f}' + ('' if value['sd'] is None else f' +-{value["sd"]:.3f}')


def models(
    seeds: Annotated[int, typer.Option(min=1, help='Trainings per model, with as many seeds.')] = 3,
    model: Annotated[
        list[str] | None, typer.Option(help='Only this model; may be given more than once.')
    ] = None,
    size: Annotated[
        Literal['full', 'native', 'quick'],
        typer.Option(help='full (CPU, hours), native (GPU) or quick (minutes).'),
    ] = 'full',
    protocol: Annotated[
        list[str] | None,
        typer.Option(help='paper: one session split 8:2; other_days; by default both.'),
    ] = None,
    quick: Annotated[
        bool, typer.Option('--quick', help='The same as --size quick --seeds 1.')
    ] = False,
    out: Annotated[
        Path, typer.Option(help='Output folder; an interrupted run continues there.')
    ] = Path('runs/models'),
    jobs: Annotated[int, typer.Option(min=1, help='Number of processes.')] = 2,
    json: JsonFile = None,
) -> None:
    """Train all models on one simulated sensor and test them on fresh trials: one table."""
    if quick:
        size, seeds = 'quick', 1
    for names, known in ((model, NETWORKS), (protocol, PROTOCOLS)):
        for name in set(names or ()).difference(known):
            raise ConfigError(f'{name!r} is unknown', remedy=f'choose from {", ".join(known)}')
    chosen = [
        name for name, each in NETWORKS.items() if (name in model if model else not each.on_request)
    ]
    protocols = [name for name in PROTOCOLS if name in (protocol or PROTOCOLS)]
    console = Console(markup=False)
    with Progress(console=console, transient=True) as progress:
        context = Context(TABLE_SIZES[size], out, seeds, jobs, progress)
        tables = {each: table_of(context, chosen, each) for each in protocols}
    rows: list[dict[str, Any]] = []
    for each, table in tables.items():
        found = rows_of(table, each, size)
        lines = [(row['model'], *(cell(row.get(kind)) for kind in KINDS.values())) for row in found]
        title = f'MAE [N], {each}, simulated, {PRESET}, {size}, {seeds} seeds'
        console.print(make_table(title, ('model', *KINDS.values()), lines))
        rows += found
    result = {'size': size, 'seeds': seeds, 'simulated': True, 'rows': rows, 'tables': tables}
    write_json(json, result | {'table': tables.get('other_days', {})})


def table_of(context: Context, chosen: Sequence[str], protocol: str) -> dict[str, Any]:
    """Return the table of some networks, as `aggregate` does."""
    data = table_data(context.sizes, protocol)
    tests = test_specs(context.sizes, protocol)
    weights, found = train_and_test(context, protocol, chosen, lambda _: data, lambda _: tests)
    cost: dict[str, list[float]] = {}
    for (name, _), trained in weights.items():
        cost.setdefault(name, []).append(trained.card.training[COST])
    return aggregate(found, cost)
