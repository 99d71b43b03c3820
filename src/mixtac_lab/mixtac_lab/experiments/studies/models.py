# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Tables of all models, trained with several seeds and judged on the same trials.

Beside the networks stand two bounds that need no training: the best constant, and a model that
knows everything except the stiffness of the gel, which no camera can see. `adaptation` shows what
adaptation gains on simulated sensors that no training has used.
"""

from __future__ import annotations

import json
import json as json_module
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, List, Optional  # noqa: UP035

import numpy as np
import typer
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from mixtac_fger.config import ConfigError
from mixtac_fger.weights import DEFAULT_MODEL, Model, find_model
from mixtac_lab.experiments.sizes import (
    ALL_ROWS,
    BOUND,
    CONSTANT,
    TABLE_FULL,
    table_run_config,
    test_specs,
    unseen_specs,
)
from mixtac_learning.adapt.adaptation import adapt
from mixtac_learning.adapt.presses import gather_presses
from mixtac_learning.judge.estimators import (
    constant_estimator,
    judge_sources,
    known_force,
    sensor_scales,
    trial_estimator,
)
from mixtac_learning.judge.metrics import CalibrationError
from mixtac_learning.judge.report import by_profile, summarise
from mixtac_learning.network import model_of, network_of
from mixtac_learning.train.config import OURS
from mixtac_learning.train.run import Run, save, trained_model, training_sources
from mixtac_learning.trials.changes import MISMATCHES, ChangedSource
from mixtac_learning.trials.simulated import SimulatedSource
from mixtac_learning.trials.store import CachedSource
from mixtac_sim.world import training_trials as generation
from mixtac_sim.world.training_trials import TrialSpec

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from mixtac_lab.experiments.sizes import Suite
    from mixtac_learning.judge.estimators import TrialEstimate, TrialEstimator
    from mixtac_learning.train.loop import Report
    from mixtac_learning.trials.trial import TrialArrays, TrialSource


_FIELDS = tuple(field.name for field in fields(TrialSpec))


@dataclass(frozen=True, slots=True)
class StiffnessBound:
    """Knows the true force but for the factor by which a simulated gel is stiffer than usual.

    Attributes:
        known_devices: Seeds of the sensors whose usual stiffness it has learned.
    """

    known_devices: frozenset[int]

    def __call__(self, trial: TrialArrays) -> TrialEstimate:
        """Return the force that the picture of a simulated trial means on a usual gel."""
        spec = TrialSpec(**{name: trial.origin[name] for name in _FIELDS})
        known = spec.device_seed in self.known_devices
        factor = generation.stiffness(spec, known_sensor=known)
        return known_force(trial).scaled(1.0 / factor)


UNSEEN, UNSEEN_GAIN = 'unseen_gel', 'unseen_gel_one_gain'


@dataclass(frozen=True, slots=True)
class Job:
    """One cell column of the table.

    Attributes:
        suite: Sizes.
        size: Their name.
        model: One of `mixtac_lab.experiments.sizes.ROWS`.
        seed: Of the training.
        folder: Where samples, checkpoints and results are kept.
    """

    suite: Suite
    size: str
    model: str
    seed: int
    folder: Path

    @property
    def result_path(self) -> Path:
        """File of the figures; its name holds the simulator's digest: others are stale."""
        digest = generation.simulator_digest()
        return self.folder / f'{self.size}_{self.model}_s{self.seed}_{digest}.json'

    def result(self) -> dict[str, Any] | None:
        """Return the figures of an earlier run, None where there are none."""
        try:
            found: dict[str, Any] = json.loads(self.result_path.read_text(encoding='utf-8'))
        except (OSError, ValueError):
            return None
        return found

    def carry_out(self, jobs: int, report: Report, say: Callable[[str], None]) -> dict[str, Any]:
        """Train and judge; a training that was cut off goes on.

        Args:
            jobs: Processes that simulate.
            report: Called after each epoch.
            say: Called with what is done now.
        """
        config = table_run_config(self.suite, self.model, self.seed, str(self.folder / 'samples'))
        training: dict[str, Any] = {}
        estimator: TrialEstimator
        if self.model == CONSTANT:
            say('constant: looking at the training forces')
            estimator = constant_estimator(_median_force(training_sources(config.data)))
        elif self.model == BOUND:
            sources = training_sources(config.data)
            estimator = StiffnessBound(frozenset(s.origin['device_seed'] for s in sources))
        else:
            say(f'{self.model}, seed {self.seed}: training')
            name = f'{self.size}_{self.model}_s{self.seed}'
            trained = Run(config, self.folder / name, jobs, report).carry_out()
            save(self.folder / name / 'model.safetensors', trained, {})
            training, estimator = trained.card.training, trial_estimator(trained_model(trained))
        say(f'{self.model}, seed {self.seed}: judging')
        figures = judge_all(estimator, self.suite, self.folder / 'trials')
        found = {'model': self.model, 'seed': self.seed, 'size': self.size, 'figures': figures}
        found['training'] = training
        self.folder.mkdir(parents=True, exist_ok=True)
        partial = self.result_path.with_suffix('.partial')
        partial.write_text(json.dumps(found, indent=1) + '\n', encoding='utf-8')
        partial.replace(self.result_path)
        return found


def judge_all(estimator: TrialEstimator, suite: Suite, cache: Path) -> dict[str, Any]:
    """Return the figures of a model in every column of the table.

    Args:
        estimator: The model.
        suite: Sizes.
        cache: Where test trials are kept for the next model.
    """

    def cached(specs: list[TrialSpec]) -> list[TrialSource]:
        return [CachedSource(SimulatedSource(spec), cache) for spec in specs]

    config = table_run_config(suite, OURS, 0, '')
    device = training_sources(config.data)[0].origin['device_seed']
    seen = cached(test_specs(suite, device))
    figures = by_profile(judge_sources(estimator, seen).estimates)
    trials, presses = map(cached, unseen_specs(suite))
    unseen = judge_sources(estimator, trials).estimates
    figures[UNSEEN] = summarise(unseen)
    scales = sensor_scales(estimator, presses, fallback=1.0)
    figures[UNSEEN_GAIN] = summarise([each.scaled(scales[each.device]) for each in unseen])
    dynamic = [source for source in seen if source.origin['profile'] == 'dynamic']
    for name, change in MISMATCHES.items():
        changed = [ChangedSource(source, name, change) for source in dynamic]
        figures[name] = summarise(judge_sources(estimator, changed).estimates)
    return figures


def _median_force(sources: list[TrialSource]) -> float:
    labels = [source.load().label() for source in sources]
    return float(np.median(np.concatenate([label.force for label in labels])))


FIGURES = (
    'mae',
    'rmse',
    'r2',
    'reference_mae',
    'peak_error',
    'fast_mae',
    'rolling_worst_mae',
    'coverage_68',
    'coverage_95',
)


def aggregate(results: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return, per model and column, mean and standard deviation over the seeds.

    Args:
        results: Of `Job.carry_out`.

    Returns:
        model -> column -> figure -> `mean`, `spread`, `seeds`; the spread of one seed is 0.
    """
    table: dict[str, Any] = {}
    for model in ALL_ROWS:
        found = [each['figures'] for each in results if each['model'] == model]
        if not found:
            continue
        columns = list(dict.fromkeys(name for figures in found for name in figures))
        table[model] = {
            column: {
                figure: _spread([f[column][figure] for f in found if figure in f.get(column, {})])
                for figure in FIGURES
                if any(figure in f.get(column, {}) for f in found)
            }
            for column in columns
        }
    return table


def _spread(values: list[float]) -> dict[str, float]:
    deviation = float(np.std(values, ddof=1)) if len(values) > 1 else 0.0
    mean = float(np.mean(values))
    return {'mean': round(mean, 4), 'spread': round(deviation, 4), 'seeds': len(values)}


def as_table(aggregated: dict[str, Any], title: str, figure: str = 'mae') -> Table:
    """Return one figure of all models for the terminal, one column per model."""
    table = Table(title=title, title_justify='left')
    table.add_column('judged on')
    for model in aggregated:
        table.add_column(model.replace('_', ' '), justify='right')
    for name in dict.fromkeys(name for row in aggregated.values() for name in row):
        cells = [_cell(row.get(name, {}).get(figure)) for row in aggregated.values()]
        table.add_row(name.replace('_', ' '), *cells)
    return table


def as_markdown(aggregated: dict[str, Any], figure: str = 'mae') -> str:
    """Return the same as Markdown."""
    columns = list(dict.fromkeys(name for row in aggregated.values() for name in row))
    head = ' | '.join(['model', *(name.replace('_', ' ') for name in columns)])
    lines = [f'| {head} |', '|---' + '|---:' * len(columns) + '|']
    for model, row in aggregated.items():
        cells = [_cell(row.get(name, {}).get(figure)) for name in columns]
        lines.append(f'| {" | ".join([model, *cells])} |')
    return '\n'.join(lines) + '\n'


def _cell(value: dict[str, float] | None) -> str:
    if value is None:
        return '-'
    spread = f' +-{value["spread"]:.3f}' if value['seeds'] > 1 else ''
    return f'{value["mean"]:.3f}{spread}'


BEFORE, ONE_GAIN, ADAPTED = 'before', 'one_gain', 'adapted'
PRESSES = 3
"""Recordings to adapt by, of 8 s each: the press that the one gain comes from, and others."""


def adaptation_study(
    model: Model, sensors: int, cache: Path, say: Callable[[str], None]
) -> dict[str, Any]:
    """Judge a model on sensors that no training used, in three states.

    Args:
        model: Content of a weight file of FGER-Net.
        sensors: How many.
        cache: Where trials are kept.
        say: Called with what is done now.

    Returns:
        `before`, `one_gain` (from one press of 8 s) and `adapted` (by `PRESSES` recordings): what
        `summarise` gives, and `sensor_mae`, one value per sensor; `ways`: what was chosen.
    """

    def cached(spec: TrialSpec) -> TrialSource:
        return CachedSource(SimulatedSource(spec), cache)

    chosen = replace(TABLE_FULL, unseen=sensors)
    found: dict[str, list[Any]] = {name: [] for name in (BEFORE, ONE_GAIN, ADAPTED)}
    ways: list[str] = []
    for test, press in zip(*unseen_specs(chosen), strict=True):
        say(f'sensor {test.device_seed}')
        seeds = [press.trial_seed + 10_000 * number for number in range(PRESSES)]
        presses = [cached(replace(press, trial_seed=seed)) for seed in seeds]
        estimator = trial_estimator(model)
        raw = judge_sources(estimator, [cached(test)]).estimates
        scales = sensor_scales(estimator, presses[:1], fallback=1.0)
        network, way = _adapted(model, presses)
        ways.append(way)
        found[BEFORE] += raw
        found[ONE_GAIN] += [each.scaled(scales[each.device]) for each in raw]
        after = trial_estimator(model_of(network, model.card))
        found[ADAPTED] += judge_sources(after, [cached(test)]).estimates
    rows: dict[str, Any] = {
        name: summarise(estimates) | {'sensor_mae': _each(estimates)}
        for name, estimates in found.items()
    }
    return rows | {'ways': ways}


def _adapted(model: Model, presses: list[TrialSource]) -> tuple[Any, str]:
    """Return the adapted network and what was chosen; the model itself where it is refused."""
    network = network_of(model)
    material = gather_presses(network, (each.load() for each in presses))
    try:
        adapted = adapt(network, material.presses)
    except CalibrationError as error:
        return network, f'refused: {error}'
    return adapted.network, adapted.way


def _each(estimates: list[Any]) -> list[float]:
    return [round(float(np.mean(np.abs(e.force - e.known))), 4) for e in estimates]


# typer evaluates these under Python 3.10.
OptionalPath = Optional[Path]  # noqa: UP045
OptionalStrings = Optional[List[str]]  # noqa: UP006, UP045


def models(
    seeds: Annotated[int, typer.Option(min=1, help='Training seeds per model.')] = 3,
    model: Annotated[
        OptionalStrings, typer.Option(help='Only this row; may be given more than once.')
    ] = None,
    size: Annotated[
        str, typer.Option(help='full or reduced (CPU, hours), native (GPU) or quick (minutes).')
    ] = 'full',
    choices: Annotated[
        bool, typer.Option('--choices', help='Ours, and with one choice undone at a time.')
    ] = False,
    quick: Annotated[bool, typer.Option('--quick', help='Short for --size quick --seeds 1.')] = (
        False
    ),
    out: Annotated[
        Path, typer.Option(help='Folder of results; a run that was cut off goes on there.')
    ] = Path('runs/models'),
    jobs: Annotated[int, typer.Option(min=1, help='Processes that simulate.')] = 2,
    json: Annotated[OptionalPath, typer.Option(help='Write the table there as well.')] = None,
) -> None:
    """Train all models on one simulated sensor and judge them on fresh trials: one table."""
    import torch

    from mixtac_lab.experiments.sizes import ALL_ROWS, CHOICES, ROWS, TABLE_SIZES, UNTRAINED
    from mixtac_learning.train.config import OURS

    if quick:
        size, seeds = 'quick', 1
    chosen = list(model or ((OURS, *CHOICES) if choices else ROWS))
    unknown = [name for name in chosen if name not in ALL_ROWS]
    if unknown or size not in TABLE_SIZES:
        raise ConfigError(
            f'model {unknown or ""} size {size!r}: choose {ALL_ROWS}; {tuple(TABLE_SIZES)}'
        )
    torch.set_num_threads(1)
    console = Console()
    work = [
        Job(TABLE_SIZES[size], size, name, seed, out)
        for seed in range(seeds)
        for name in chosen
        if name not in UNTRAINED or seed == 0
    ]
    results = []
    with Progress(console=console, transient=True) as progress:
        bar = progress.add_task('models', total=len(work))

        def report(stage: str, epoch: int, epochs: int, loss: float, error: float | None) -> None:
            del error
            text = f'{stage} {epoch}/{epochs}, loss {loss:.5f} N'
            progress.update(bar, description=text)

        for job in work:
            found = job.result()
            if found is None:
                found = job.carry_out(jobs, report, console.print)
            results.append(found)
            progress.advance(bar)
    table = aggregate(results)
    console.print(as_table(table, f'MAE [N], simulated, paper_like, {size}, {seeds} seeds'))
    name = f'table_{size}_choices.md' if choices else f'table_{size}.md'
    (out / name).write_text(as_markdown(table), encoding='utf-8')
    if json is not None:
        content = {'size': size, 'seeds': seeds, 'simulated': True, 'table': table}
        json.write_text(json_module.dumps(content, indent=2) + '\n', encoding='utf-8')


def adaptation(
    model: Annotated[str, typer.Option(help='Weight file, or name of a shipped one.')] = (
        DEFAULT_MODEL
    ),
    sensors: Annotated[int, typer.Option(min=1, help='Number of unseen sensors.')] = 6,
    out: Annotated[Path, typer.Option(help='Folder where trials are kept.')] = Path('runs/models'),
    json: Annotated[OptionalPath, typer.Option(help='Write the figures there as well.')] = None,
) -> None:
    """Judge a model on simulated sensors that no training used: as it is, one gain, adapted."""
    import torch

    from mixtac_fger.weights import read_model
    from mixtac_learning.judge.report import show_figures

    torch.set_num_threads(1)
    console = Console()
    found = adaptation_study(read_model(find_model(model)), sensors, out / 'trials', console.print)
    rows = {name: row for name, row in found.items() if isinstance(row, dict)}
    show_figures(console, f'dynamic trials of {sensors} unseen sensors, simulated', rows)
    console.print(f'chosen: {", ".join(found["ways"])}')
    if json is not None:
        content = {'model': model, 'sensors': sensors, 'simulated': True} | found
        json.write_text(json_module.dumps(content, indent=2) + '\n', encoding='utf-8')
