# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Tables of all models, trained with several seeds and tested on the same trials.

With the protocol `paper`, the trials of one session are split at random. With `other_days`, the
test trials are from other days of the same sensor.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import Progress

from mixtac_core.node.files import write_json
from mixtac_fger.config import ConfigError
from mixtac_learning.commands import JsonFile
from mixtac_learning.experiments.harness import (
    PRESET,
    TABLE_SIZES,
    VARIANTS,
    Context,
    OptionalStrings,
    Sizes,
    Value,
    run_config,
)
from mixtac_learning.experiments.training import Estimates, estimates, train
from mixtac_learning.judge.metrics import by_profile
from mixtac_learning.judge.report import make_table
from mixtac_learning.train.config import MODELS, OURS, DataConfig, SimulatedData
from mixtac_learning.train.run import training_sources
from mixtac_sim.world.plans import TrialSpec, session_plan

PROTOCOLS = ('paper', 'other_days')
"""One session of one sensor, its trials split 8:2 at random, as in the paper; or trained on some
days of a sensor and tested on others."""
ROWS = (
    *('frames', 'frames_reference', 'events', 'fusion', 'fusion_reference'),
    *('fger', 'fger_reference', OURS),
)
"""Models of the table, in order."""
ALL_ROWS = tuple(dict.fromkeys((*ROWS, *MODELS, *VARIANTS)))
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
        runs = [by_profile(trials) for trials in by_seed.values()]
        columns: dict[str, list[dict[str, Any]]] = {
            column: [run[column] for run in runs] for column in runs[0]
        }
        columns[TRAINING] = [{COST: each} for each in cost[model]]
        table[model] = {column: {} for column in columns}
        for column, figures in columns.items():
            for figure in FIGURES:
                each = [row[figure] for row in figures if figure in row]
                if each:
                    value = Value.of(each)
                    mean, spread = round(value.mean, 4), round(value.spread, 4)
                    cell = {'mean': mean, 'spread': spread, 'seeds': len(each)}
                    table[model][column][figure] = cell
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
        OptionalStrings, typer.Option(help='Only this model; may be given more than once.')
    ] = None,
    size: Annotated[
        str, typer.Option(help='full (CPU, hours), native (GPU) or quick (minutes).')
    ] = 'full',
    protocol: Annotated[
        OptionalStrings,
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
    for name, known, kind in (
        *((each, ALL_ROWS, 'model') for each in model or ()),
        *((each, PROTOCOLS, 'protocol') for each in protocol or ()),
        (size, TABLE_SIZES, 'size'),
    ):
        if name not in known:
            raise ConfigError(f'unknown {kind} {name!r}', remedy=f'choose from {", ".join(known)}')
    chosen = [name for name in ALL_ROWS if name in (model or ROWS)]
    protocols = [name for name in PROTOCOLS if name in (protocol or PROTOCOLS)]
    console = Console(markup=False)
    with Progress(console=console, transient=True) as progress:
        context = Context(TABLE_SIZES[size], out, seeds, jobs, progress)
        tables = {each: train_and_test(context, chosen, each) for each in protocols}
    rows: list[dict[str, Any]] = []
    for each, table in tables.items():
        found = rows_of(table, each, size)
        lines = [(row['model'], *(cell(row.get(kind)) for kind in KINDS.values())) for row in found]
        title = f'MAE [N], {each}, simulated, {PRESET}, {size}, {seeds} seeds'
        console.print(make_table(title, ('model', *KINDS.values()), lines))
        rows += found
    result = {'size': size, 'seeds': seeds, 'simulated': True, 'rows': rows, 'tables': tables}
    write_json(json, result | {'table': tables.get('other_days', {})})


def train_and_test(context: Context, chosen: list[str], protocol: str) -> dict[str, Any]:
    """Return the table of some models, as `aggregate` does."""
    sizes, data = context.sizes, table_data(context.sizes, protocol)
    configs = {
        (name, seed): run_config(sizes, name, seed, data)
        for name in chosen
        for seed in range(context.seeds)
    }
    weights = train(context, configs)
    cost: dict[str, list[float]] = {name: [] for name in chosen}
    for (name, _), trained in weights.items():
        cost[name].append(trained.card.training[COST])
    tests = [(spec, weights) for spec in test_specs(sizes, protocol)]
    return aggregate(estimates(context, protocol, tests), cost)
