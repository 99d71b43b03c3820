# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Tables of all models, trained with several seeds and evaluated on the same trials.

By the protocol `paper` these are the trials of one session, split at random; by `other_days` the
tests are other days of the sensor, other sensors, and trials made worse on purpose.

Two bounds that need no training are added to the networks: the best constant, and a model that
knows everything except the stiffness of the gel, which no camera can see.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
import typer
from rich.console import Console
from rich.progress import Progress

from mixtac_core.node.files import write_json, write_text
from mixtac_fger.config import ConfigError
from mixtac_fger.weights import read_model
from mixtac_learning.commands import JsonFile
from mixtac_learning.experiments.harness import (
    ALL_ROWS,
    CHOICES,
    PRESET,
    PROTOCOLS,
    ROWS,
    TABLE_SIZES,
    UNTRAINED,
    Context,
    OptionalStrings,
    Sizes,
    Value,
    run_config,
)
from mixtac_learning.experiments.store import Piece
from mixtac_learning.experiments.training import LEARNING_CODE, train
from mixtac_learning.judge.estimators import (
    TrialEstimate,
    TrialEstimator,
    constant_estimator,
    judge_sources,
    known_force,
    sensor_scales,
    trial_estimator,
)
from mixtac_learning.judge.report import (
    by_profile,
    make_table,
    summarise,
)
from mixtac_learning.train.config import OURS, DataConfig, SimulatedData
from mixtac_learning.train.run import training_sources
from mixtac_learning.trials.store import CachedSource
from mixtac_learning.trials.trial import (
    MISMATCHES,
    ChangedSource,
    SimulatedSource,
    TrialArrays,
    TrialSource,
)
from mixtac_sim.world import plans as generation
from mixtac_sim.world.plans import TrialSpec, session_plan

FIRST_TRIAL = 800_000
"""First trial seed of the tests; training uses 100,000 to 200,000."""
FIRST_DEVICE = 810_000
"""First seed of the sensors that no training uses."""
UNSEEN, UNSEEN_GAIN = 'unseen_gel', 'unseen_gel_one_gain'
TRAINING, COST = 'training', 'core_minutes'
FIGURES = (
    'mae',
    'rmse',
    'r2',
    'reference_mae',
    'peak_error',
    'fast_mae',
    'rolling_worst_mae',
    'frame_jump',
    'hold_noise',
    'lag_ms',
    'coverage_68',
    'coverage_95',
    COST,
)
_FIELDS = tuple(field.name for field in fields(TrialSpec))


@dataclass(frozen=True, slots=True)
class StiffnessBound:
    """Knows the true force except for the factor by which a simulated gel is stiffer than usual.

    Attributes:
        known_devices: Seeds of the sensors whose usual stiffness is known.
    """

    known_devices: frozenset[int]

    def __call__(self, trial: TrialArrays) -> TrialEstimate:
        """Return the force that the image of a simulated trial implies for a usual gel."""
        spec = TrialSpec(**{name: trial.origin[name] for name in _FIELDS})
        known = spec.device_seed in self.known_devices
        factor = generation.stiffness(spec, known_sensor=known)
        return known_force(trial).scaled(1.0 / factor)


def table_data(sizes: Sizes, model: str, protocol: str = 'other_days') -> DataConfig:
    """Return the training trials of a model; they are the same for every seed.

    All models keep the same trials to choose weights by, ours to calibrate its uncertainty as
    well: a seventh of one sensor's trials, a ninth of many sensors'.
    """
    many = model == 'ours_many_sensors'
    count = sizes.sensors if many else sizes.trials
    data = SimulatedData((PRESET,), count if many else 1, count, sizes.seconds, sizes.mix)
    if protocol == 'paper':
        data = replace(data, session=sizes.session)
    return DataConfig(simulated=data, checked=1 / 9 if many else 1 / 7)


def test_specs(sizes: Sizes, device: int, protocol: str) -> list[TrialSpec]:
    """Return the test trials on the training sensor: of the same session, or other days."""
    if protocol == 'paper':
        data = table_data(sizes, OURS, protocol).simulated
        return [] if data is None else session_plan(data.session, data.seed, data.presets[0])[1]
    return [
        TrialSpec(device, FIRST_TRIAL + 100 * row + column, profile, seconds, PRESET)
        for column, (profile, (count, seconds)) in enumerate(sizes.tests.items())
        for row in range(count)
    ]


def unseen_specs(sizes: Sizes) -> tuple[list[TrialSpec], list[TrialSpec]]:
    """Return dynamic trials of sensors that no training used, and one press of each."""
    devices = range(FIRST_DEVICE, FIRST_DEVICE + sizes.unseen)
    seconds = sizes.tests['dynamic'][1]
    return (
        [TrialSpec(d, d + 10_000, 'dynamic', seconds, PRESET) for d in devices],
        [TrialSpec(d, d + 20_000, 'press', 8.0, PRESET) for d in devices],
    )


def model_figures(
    base: Path, sizes: Sizes, model: str, protocol: str, weights: str
) -> dict[str, Any]:
    """Return the figures of a model in every column of the table; a piece of work.

    Args:
        base: Path of the result; test trials are stored beside its folder for the next model.
        sizes: Numbers and lengths of the trials.
        model: One of `ALL_ROWS`.
        protocol: One of `PROTOCOLS`; foreign sensors and mismatches belong to `other_days`.
        weights: Stem of the weight file in the folder of the result; empty without training.
    """
    torch.set_num_threads(1)
    trials, cost = base.parent.parent / 'trials', {}

    def cached(specs: Iterable[TrialSpec]) -> list[TrialSource]:
        return [CachedSource(SimulatedSource(spec), trials) for spec in specs]

    sources = training_sources(table_data(sizes, model, protocol))
    if model == 'constant':
        kept = [CachedSource(source, trials) for source in sources]
        forces = np.concatenate([source.load().label().force for source in kept])
        estimator: TrialEstimator = constant_estimator(float(np.median(forces)))
    elif model == 'all_but_stiffness':
        estimator = StiffnessBound(frozenset(s.origin['device_seed'] for s in sources))
    else:
        trained = read_model(base.with_name(f'{weights}.safetensors'))
        estimator = trial_estimator(trained)
        cost = {COST: trained.card.training[COST]}
    (first, *_) = training_sources(table_data(sizes, OURS))
    seen = cached(test_specs(sizes, first.origin['device_seed'], protocol))
    figures = by_profile(judge_sources(estimator, seen).estimates) | {TRAINING: cost}
    if protocol == 'paper' or not sizes.unseen:
        return figures
    tests, presses = map(cached, unseen_specs(sizes))
    unseen = judge_sources(estimator, tests).estimates
    figures[UNSEEN] = summarise(unseen)
    scales = sensor_scales(estimator, presses, fallback=1.0)
    figures[UNSEEN_GAIN] = summarise([each.scaled(scales[each.device]) for each in unseen])
    dynamic = [source for source in seen if source.origin['profile'] == 'dynamic']
    for name, change in MISMATCHES.items():
        changed = [ChangedSource(source, name, change) for source in dynamic]
        figures[name] = summarise(judge_sources(estimator, changed).estimates)
    return figures


def aggregate(found: Mapping[str, Sequence[Mapping[str, Any]]]) -> dict[str, Any]:
    """Return mean and standard deviation over the seeds.

    Args:
        found: Figures of each seed (`model_figures`) by model.

    Returns:
        model -> column -> figure -> `mean`, `spread`, `seeds`; the spread of one seed is 0.
    """
    table: dict[str, Any] = {}
    for model, runs in found.items():
        table[model] = {column: {} for run in runs for column in run}
        for column, cell in table[model].items():
            for figure in FIGURES:
                each = [r[column][figure] for r in runs if figure in r.get(column, {})]
                if each:
                    value = Value.of(each)
                    mean, spread = round(value.mean, 4), round(value.spread, 4)
                    cell[figure] = {'mean': mean, 'spread': spread, 'seeds': len(each)}
    return table


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
    names = {'dynamic': 'dynamic', 'static': 'static', 'long_term': 'hold', 'impact': 'impact'}
    rows = []
    for model, columns in table.items():
        row: dict[str, Any] = {'model': model, 'protocol': protocol, 'size': size}
        if columns.get(TRAINING):
            row[COST] = columns[TRAINING][COST]['mean']
        for profile, name in names.items():
            found = columns.get(profile, {}).get('mae')
            if found is not None:
                sd = found['spread'] if found['seeds'] > 1 else None
                row[name] = {'mae': found['mean'], 'sd': sd, 'seeds': found['seeds']}
        rows.append(row)
    return rows


def lines_of(table: Mapping[str, Any]) -> list[list[str]]:
    """Return the MAE as text: headings with the columns, then a line per model."""
    columns = dict.fromkeys(c for row in table.values() for c in row if c != TRAINING)
    headings = ['model', *(column.replace('_', ' ') for column in columns)]
    cells = [[_cell(row.get(c, {}).get('mae')) for c in columns] for row in table.values()]
    return [headings, *([model, *row] for model, row in zip(table, cells, strict=True))]


def _cell(value: dict[str, float] | None) -> str:
    if value is None:
        return '-'
    spread = f' +-{value["spread"]:.3f}' if value['seeds'] > 1 else ''
    return f'{value["mean"]:.3f}{spread}'


def models(
    seeds: Annotated[int, typer.Option(min=1, help='Trainings per model, with as many seeds.')] = 3,
    model: Annotated[
        OptionalStrings, typer.Option(help='Only this model; may be given more than once.')
    ] = None,
    size: Annotated[
        str,
        typer.Option(help='full or reduced (CPU, hours), native (GPU) or quick (minutes).'),
    ] = 'full',
    protocol: Annotated[
        OptionalStrings,
        typer.Option(help='paper: one session split 8:2; other_days; by default both.'),
    ] = None,
    choices: Annotated[
        bool,
        typer.Option('--choices', help='Our network, and variants with one design choice undone.'),
    ] = False,
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
    chosen = list(model or ((OURS, *CHOICES) if choices else ROWS))
    protocols = [name for name in PROTOCOLS if name in (protocol or PROTOCOLS)]
    for name, known, kind in (
        *((each, ALL_ROWS, 'model') for each in chosen),
        *((each, PROTOCOLS, 'protocol') for each in protocol or ()),
        (size, TABLE_SIZES, 'size'),
    ):
        if name not in known:
            raise ConfigError(f'unknown {kind} {name!r}', remedy=f'choose from {", ".join(known)}')
    console = Console(markup=False)
    with Progress(console=console, transient=True) as progress:
        context = Context(TABLE_SIZES[size], out, seeds, jobs, None, progress)
        names = [name for name in ALL_ROWS if name in chosen]
        tables = {each: aggregate(train_and_test(context, names, each)) for each in protocols}
    rows: list[dict[str, Any]] = []
    for each, table in tables.items():
        lines = lines_of(table)
        title = f'MAE [N], {each}, simulated, {PRESET}, {size}, {seeds} seeds'
        console.print(make_table(title, lines[0], lines[1:]))
        marks = ['---', *['---:'] * (len(lines[0]) - 1)]
        file = f'table_{size}_{each}_choices.md' if choices else f'table_{size}_{each}.md'
        text = [f'| {" | ".join(line)} |' for line in (lines[0], marks, *lines[1:])]
        write_text(out / file, '\n'.join([*text, '']))
        rows += rows_of(table, each, size)
    result = {'size': size, 'seeds': seeds, 'simulated': True, 'rows': rows, 'tables': tables}
    write_json(json, result | {'table': tables.get('other_days', {})})


def train_and_test(
    context: Context, chosen: Sequence[str], protocol: str
) -> dict[str, list[dict[str, Any]]]:
    """Return the figures of models, one dictionary per seed; of a model without training one."""
    sizes = context.sizes
    if protocol == 'paper':
        chosen = [name for name in chosen if name != 'ours_many_sensors']
    configs = {
        (name, seed): run_config(sizes, name, seed, table_data(sizes, name, protocol))
        for seed in range(context.seeds)
        for name in chosen
        if name not in UNTRAINED
    }
    weights = train(context, configs) | {(name, 0): '' for name in chosen if name in UNTRAINED}
    pieces = [
        Piece(
            f'table_{sizes.name}_{protocol}_{name}_s{seed}',
            model_figures,
            (sizes, name, protocol, stem),
            LEARNING_CODE,
        )
        for (name, seed), stem in weights.items()
    ]
    found: dict[str, list[dict[str, Any]]] = {name: [] for name in chosen}
    for (name, _), figures in zip(weights, context.run('testing', pieces), strict=True):
        found[name].append(figures)
    return found
