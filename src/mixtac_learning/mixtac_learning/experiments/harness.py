# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""How an experiment becomes a command, stores its results, and reports them.

An experiment is a function from a `Context` to an `Outcome`: rows that set our values beside the
values of the paper, and figures. Its docstring is the help of its command: what it measures, what
the paper did, and how this differs. Results of long computations are stored in a folder, so that an
interrupted run continues where it stopped.
"""

from __future__ import annotations

import datetime as dt
import functools
import hashlib
import math
import os
import pkgutil
import platform
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, TypeVar

import joblib
import numpy as np
import typer
from rich.console import Console
from rich.markdown import Markdown
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from mixtac.options import JsonFile
from mixtac_core.events.errors import MixtacError
from mixtac_core.node.files import read_data, structure, write_json, write_text
from mixtac_fger.weights import DEFAULT_MODEL, find_model
from mixtac_learning.experiments import EXPERIMENTS
from mixtac_learning.train.config import DataConfig, RunConfig
from mixtac_sim.world.plans import simulator_digest

T = TypeVar('T')
PRESET = 'paper_like'
"""Difficulty preset of the simulated sensors."""


@dataclass(frozen=True, slots=True)
class Sizes:
    """Numbers and lengths of trials, and training settings.

    Attributes:
        name: Name of this set of sizes.
        trials: Training trials of each sensor.
        seconds: Length of a training trial [s].
        mix: Force profiles of the training trials, in turn.
        tests: Number and length [s] of the test trials by profile.
        training: Training settings that differ from the defaults, of networks of the `paper` and of
            `ours`.
        network: The same of the configuration of the networks.
        session: Number and length [s] of the trials of the protocol `paper`, by profile.
        session_training: Differences from `training` by that protocol.
        tones_hz: Vibration frequencies [Hz].
        fast_tones_hz: Vibration frequencies above those of the paper [Hz].
        grasps: Number of slip trials by object.
        latency_seconds: Length of the real-time run in which latency is measured [s].
    """

    name: str
    trials: int
    seconds: float
    mix: tuple[str, ...]
    tests: dict[str, tuple[int, float]]
    training: dict[str, dict[str, Any]]
    network: dict[str, dict[str, Any]] = field(default_factory=dict)
    session: dict[str, tuple[int, float]] = field(default_factory=dict)
    session_training: dict[str, dict[str, Any]] = field(default_factory=dict)
    tones_hz: tuple[float, ...] = ()
    fast_tones_hz: tuple[float, ...] = ()
    grasps: dict[str, int] = field(default_factory=dict)
    latency_seconds: float = 5.0


_PATH = Path(__file__).with_name('sizes.yaml')
_TABLES = read_data(_PATH)


def _sizes(table: str) -> dict[str, Sizes]:
    return {
        name: structure({'name': name, **values}, Sizes, f'{_PATH}: {name}')
        for name, values in _TABLES[table].items()
    }


PAPER_SIZES = _sizes('paper')
"""Sizes of the experiments of the paper."""
TABLE_SIZES = _sizes('table')
"""Sizes of the table of all models (`mixtac experiments models --size`)."""


@dataclass(frozen=True, slots=True)
class Network:
    """A network that is trained and compared.

    Attributes:
        model: One of `mixtac_learning.train.config.MODELS`; by default that of its own name.
        network: Fields of its configuration that differ from the sizes.
        training: Training settings that differ from the sizes.
        sizes: Key of `Sizes.training` and `Sizes.network`.
        label: Name in reports.
        colour: Colour in figures.
        on_request: Whether the table has it only where it is named.
    """

    model: str
    network: dict[str, Any] = field(default_factory=dict)
    training: dict[str, Any] = field(default_factory=dict)
    sizes: str = 'paper'
    label: str = ''
    colour: str = ''
    on_request: bool = False


NETWORKS = {
    name: structure({'model': name, **values}, Network, f'{_PATH}: {name}')
    for name, values in _TABLES['networks'].items()
}
"""Networks by name."""


def run_config(sizes: Sizes, name: str, seed: int, data: DataConfig) -> RunConfig:
    """Return the training run of a network.

    Args:
        sizes: Training settings.
        name: One of `NETWORKS`.
        seed: Seed of initial weights and order.
        data: Training trials.
    """
    chosen = NETWORKS[name]
    training = sizes.training[chosen.sizes]
    if data.simulated is not None and data.simulated.session:
        training = training | sizes.session_training.get(chosen.sizes, {})
    return RunConfig(
        model=chosen.model,
        network=sizes.network.get(chosen.sizes, {}) | chosen.network,
        training=training | chosen.training | {'seed': seed},
        data=data,
    )


PACKAGES = ('core', 'fger', 'sim', 'slip_control', 'learning')
"""Packages that results depend on, without `mixtac_`."""


@functools.cache
def code_version() -> str:
    """Return a digest of the files of `PACKAGES` and of the shipped weights."""
    digest = hashlib.blake2b(find_model(DEFAULT_MODEL).read_bytes(), digest_size=6)
    for name in PACKAGES:
        root = Path(str(files(f'mixtac_{name}')))
        for path in sorted(root.rglob('*')):
            if path.is_file() and path.parent.name != '__pycache__':
                digest.update(str(path.relative_to(root)).encode() + path.read_bytes())
    return digest.hexdigest()


def _call(path: Path | None, function: Callable[..., T], *arguments: Any) -> T:  # noqa: ANN401
    """Return the result that a JSON file holds, or compute it and write the file."""
    if path is not None and path.exists():
        stored: T = read_data(path)
        return stored
    result = function(*arguments)
    write_json(path, result)
    return result


@dataclass(frozen=True, slots=True)
class Value:
    """Mean and spread of measured values.

    Attributes:
        mean: Mean; NaN without values.
        spread: Standard deviation; 0 for a single value.
        count: Number of values.
        over: What the values differ in: seeds, trials, repetitions.
    """

    mean: float
    spread: float
    count: int
    over: str

    @classmethod
    def of(cls, values: Iterable[float], over: str = 'seeds') -> Value:
        """Return mean and spread of the finite values."""
        good = [value for value in values if math.isfinite(value)]
        if not good:
            return cls(math.nan, 0.0, 0, over)
        spread = float(np.std(good, ddof=1)) if len(good) > 1 else 0.0
        return cls(float(np.mean(good)), spread, len(good), over)

    def as_dict(self) -> dict[str, Any]:
        """Return values ready for JSON; the mean of no values is None."""
        mean = round(self.mean, 5) if math.isfinite(self.mean) else None
        return asdict(self) | {'mean': mean, 'spread': round(self.spread, 5)}

    def __str__(self) -> str:
        """Return mean, spread and number of values as text."""
        if self.count < 2:
            return number(self.mean)
        # Rounding leaves a tiny spread of equal values.
        spread = self.spread if self.spread > 1e-9 * abs(self.mean) else 0.0
        return f'{number(self.mean)} ± {number(spread)} ({self.count} {self.over})'


@dataclass(frozen=True, slots=True)
class Row:
    """One line of a report.

    Attributes:
        name: What was measured.
        ours: Our value.
        paper: Value of the paper; None if the paper gives none.
        place: Section, figure or table of the paper.
        unit: Unit of both values; empty for ratios.
        conditions: Conditions of our measurement.
        simulated: Whether the data are simulated.
    """

    name: str
    ours: Value
    paper: float | None
    place: str
    unit: str
    conditions: str
    simulated: bool = True


@dataclass(frozen=True, slots=True)
class Outcome:
    """Result of an experiment.

    Attributes:
        data: Data set: name, seeds, preset, sizes.
        rows: Values beside those of the paper.
        figures: Image files by caption.
    """

    data: str
    rows: list[Row] = field(default_factory=list)
    figures: dict[str, Path] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Return values ready for JSON; figures by their file names."""
        rows = [asdict(row) | {'ours': row.ours.as_dict()} for row in self.rows]
        figures = {caption: path.name for caption, path in self.figures.items()}
        return {'data': self.data, 'rows': rows, 'figures': figures}


def write_report(
    folder: Path, outcomes: Mapping[str, Outcome], run: dict[str, Any], json: Path | None = None
) -> str:
    """Write `report.md` and `report.json`; return the text of `report.md`.

    Args:
        folder: Folder of the report.
        outcomes: Results of the experiments, by name.
        run: Description of the run: command, sizes, seeds, versions.
        json: Another file for the content of `report.json`; None for none.
    """
    experiments = [described(name) | outcome.as_dict() for name, outcome in outcomes.items()]
    rows = [{'experiment': each['name']} | row for each in experiments for row in each['rows']]
    for path in (folder / 'report.json', json):
        write_json(path, {'run': run, 'rows': rows, 'experiments': experiments})
    lines: list[str] = []
    for name, outcome in outcomes.items():
        lines += [f'### {name}', '', f'{outcome.data}.', '']
        lines += ['| what | ours | paper | unit |', '|---|---:|---:|---|']
        for row in outcome.rows:
            paper = '' if row.paper is None else number(row.paper)
            lines.append(f'| {row.name} | {row.ours} | {paper} | {row.unit} |')
        lines.append('')
    text = '\n'.join(lines)
    write_text(folder / 'report.md', text)
    return text


def described(name: str) -> dict[str, Any]:
    """Return what the docstring of an experiment says: title, the paper, and each difference."""
    title, paper, *differences = _paragraphs(select([name])[name])
    return {'name': name, 'title': title, 'paper': paper, 'deviations': differences}


def _paragraphs(function: Callable[[Context], Outcome]) -> list[str]:
    """Return the paragraphs of a docstring, each without ends of lines."""
    return [' '.join(part.split()) for part in str(function.__doc__).split('\n\n')]


def number(value: float) -> str:
    """Return a number with three significant digits, large ones in groups; `-` for NaN."""
    if not math.isfinite(value):
        return '-'
    if abs(value) < 1e8 and (abs(value) >= 1000 or value == round(value)):
        return f'{value:,.0f}'
    return f'{value:.3g}'


ALL = 'all'


@dataclass(frozen=True, slots=True, eq=False)
class Context:
    """A run of experiments.

    Attributes:
        sizes: How much to compute.
        folder: Folder of the report and of the stored results.
        seeds: Number of seeds; each is another training and another simulated sensor.
        jobs: Number of processes.
        progress: Shows progress bars.
    """

    sizes: Sizes
    folder: Path
    seeds: int
    jobs: int
    progress: Progress

    def figure(self, name: str) -> Path:
        """Return the path of a figure."""
        return self.folder / 'figures' / f'{name}.png'

    def run(
        self,
        title: str,
        function: Callable[..., T],
        cases: Sequence[tuple[Any, ...]],
        *,
        stored: bool = True,
    ) -> list[T]:
        """Return the results of a function for some arguments, in order, with a progress bar.

        Args:
            title: Title of the progress bar.
            function: A function of a module; it can be sent to other processes.
            cases: Arguments of each call.
            stored: Store the results as JSON below `folder`, by arguments and code, and do not
                compute them again.
        """
        bar = self.progress.add_task(title, total=len(cases))
        pieces = self.folder / 'pieces'
        pieces.mkdir(parents=True, exist_ok=True)
        keys = [joblib.hash((code_version(), function.__qualname__, case)) for case in cases]
        calls = [
            joblib.delayed(_call)(pieces / f'{key}.json' if stored else None, function, *case)
            for key, case in zip(keys, cases, strict=True)
        ]
        # Processes share the cores, so each gets one thread.
        jobs = min(self.jobs, len(cases)) or 1
        with joblib.parallel_config('loky', n_jobs=jobs, inner_max_num_threads=1):
            found = joblib.Parallel(return_as='generator', batch_size=1)(calls)
            return [*self.progress.track(found, task_id=bar)]


def command(name: str, text: str) -> Callable[..., dict[str, Outcome]]:
    """Return the command that runs an experiment, or all for the name `all`.

    It writes the report and returns the results. Finished pieces stay stored where one fails.

    Args:
        name: Name of the experiment.
        text: Help of the command.
    """

    def run(
        more: Annotated[
            list[str] | None, typer.Argument(help='Further experiments to run.')
        ] = None,
        quick: Annotated[
            bool, typer.Option('--quick', help='Run for minutes only; results are meaningless.')
        ] = False,
        json: JsonFile = None,
        out: Annotated[
            Path | None,
            typer.Option(help='Output folder; an interrupted run continues there.'),
        ] = None,
        seeds: Annotated[
            int, typer.Option(min=0, help='Number of seeds; 0: three, or one with --quick.')
        ] = 0,
        jobs: Annotated[int, typer.Option(min=0, help='Number of processes; 0: one per core.')] = 0,
    ) -> dict[str, Outcome]:
        chosen = select([name, *(more or [])])
        size, console = PAPER_SIZES['quick' if quick else 'full'], Console(markup=False)
        folder = out or Path('runs') / f'experiments_{size.name}'
        seeds, jobs = seeds or (1 if quick else 3), jobs or os.cpu_count() or 1
        started = time.monotonic()
        columns = (TextColumn('{task.description}'), BarColumn(), MofNCompleteColumn())
        with Progress(*columns, TimeElapsedColumn(), console=console) as progress:
            context = Context(size, folder, seeds, jobs, progress)
            outcomes = {each: function(context) for each, function in chosen.items()}
        options = ['--quick'] * quick + [f'--seeds {seeds}', f'--out {folder.name}']
        minutes = (time.monotonic() - started) / 60
        python = platform.python_version()
        description = {
            'command': ' '.join(['./mixtac experiments', *chosen, *options]),
            'experiments': ', '.join(chosen),
            'sizes': size.name,
            'seeds': seeds,
            'processes': jobs,
            'data': 'virtual sensor (simulated)',
            'simulator': simulator_digest(),
            'machine': f'{os.cpu_count()} cores, {platform.machine()}, Python {python}',
            'minutes': f'{minutes:.1f}, without results that were stored before',
            'date': f'{dt.datetime.now(dt.timezone.utc):%Y-%m-%d}',
        }
        console.print(Markdown(write_report(folder, outcomes, description, json)))
        console.print(f'report: {folder / "report.md"}')
        return outcomes

    run.__name__, run.__doc__ = name, text
    return run


all_experiments = command(ALL, 'Run all experiments of the paper.')


def experiment(function: Callable[[Context], Outcome]) -> Callable[..., dict[str, Outcome]]:
    """Make a function `Context -> Outcome` a command; its docstring is the help."""
    # Typer would keep the ends of lines.
    made = command(function.__name__, '\n\n'.join(_paragraphs(function)))
    made.run = function  # type: ignore[attr-defined]
    return made


def select(names: Sequence[str]) -> dict[str, Callable[[Context], Outcome]]:
    """Return experiments by name, each once, in the order of the paper.

    Args:
        names: Names of experiments; `all` stands for all of them.

    Raises:
        MixtacError: There is no such experiment.
    """
    places = {name: EXPERIMENTS[name] for name in EXPERIMENTS if name not in {ALL, 'models'}}
    for name in set(names).difference(places, {ALL}):
        known = ', '.join(sorted(places))
        raise MixtacError(f'unknown experiment {name!r}', remedy=f'choose from {known}, or all')
    return {
        name: pkgutil.resolve_name(place).run
        for name, place in places.items()
        if ALL in names or name in names
    }
