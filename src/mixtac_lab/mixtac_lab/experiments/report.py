# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Outcomes of experiments, their reports as JSON and Markdown, and curves."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console

from mixtac_cli.figures import make_table
from mixtac_node.files import read_data, write_json, write_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from mixtac_learning.judge.estimators import TrialEstimate

TRUTH, PAPER = '#1f1f1f', '#8a8a8a'
"""Colours of the true force and of the paper's values."""


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
        known = math.isfinite(self.mean)
        return {
            'mean': round(self.mean, 5) if known else None,
            'spread': round(self.spread, 5),
            'count': self.count,
            'over': self.over,
        }


@dataclass(frozen=True, slots=True)
class Row:
    """One line of a report.

    Attributes:
        name: What was measured.
        ours: Our value.
        paper: Value of the paper; None if the paper gives none.
        place: Section, figure or table of the paper; empty without a value of the paper.
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

    @property
    def marked(self) -> bool:
        """Whether our value exists and is marked as simulated."""
        return self.simulated and self.ours.count > 0

    @property
    def cells(self) -> tuple[str, str, str, str]:
        """The row as text, by `HEADINGS`."""
        paper = '' if self.paper is None else number(self.paper)
        return self.name, value_text(self.ours), paper, self.unit

    def as_dict(self) -> dict[str, Any]:
        """Return values ready for JSON."""
        return asdict(self) | {'ours': self.ours.as_dict()}


@dataclass(frozen=True, slots=True)
class Outcome:
    """Result of an experiment.

    Attributes:
        name: Name of the experiment.
        title: Display name.
        paper: What the paper did, in a sentence or two.
        data: Data set: name, seeds, preset, sizes.
        rows: Values beside those of the paper.
        figures: Image files by caption.
        deviations: Differences from the paper's protocol.
        skipped: Why the experiment was not run; empty if it was.
        table: A table as the paper prints it, the first line being headings; empty for none.
    """

    name: str
    title: str
    paper: str
    data: str
    rows: list[Row] = field(default_factory=list)
    figures: dict[str, Path] = field(default_factory=dict)
    deviations: tuple[str, ...] = ()
    skipped: str = ''
    table: tuple[tuple[str, ...], ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Return values ready for JSON; figures by their file names."""
        return asdict(self) | {
            'rows': [row.as_dict() for row in self.rows],
            'figures': {caption: path.name for caption, path in self.figures.items()},
        }


def texts(name: str) -> dict[str, Any]:
    """Return what `texts.yaml` says of an experiment, by names of fields of `Outcome`.

    Those that draw the forces of models also have a `caption` of their figure.
    """
    found: dict[str, Any] = read_data(Path(__file__).with_name('texts.yaml'))[name]
    return {'name': name, **found, 'deviations': tuple(found['deviations'])}


HEADINGS = ('what', 'ours', 'paper', 'unit')


def write(
    folder: Path, outcomes: Sequence[Outcome], run: Mapping[str, Any], json: Path | None = None
) -> None:
    """Write `report.md` and `report.json`.

    Args:
        folder: Folder of the report.
        outcomes: Results of the experiments.
        run: Description of the run: command, sizes, seeds, versions.
        json: Another file for what `report.json` holds; None for none.
    """
    rows = [
        {'experiment': outcome.name} | row.as_dict() for outcome in outcomes for row in outcome.rows
    ]
    experiments = [outcome.as_dict() for outcome in outcomes]
    content = {'run': dict(run), 'rows': rows, 'experiments': experiments}
    for path in (folder / 'report.json', json):
        write_json(path, content)
    write_text(folder / 'report.md', '\n'.join(map(_markdown, outcomes)))


def show(console: Console, outcomes: Sequence[Outcome]) -> None:
    """Print the rows of all outcomes as tables."""
    for outcome in outcomes:
        if outcome.skipped:
            console.print(f'{outcome.title} skipped: {outcome.skipped}')
            continue
        rows = [
            (f'{row.name}, simulated' if row.marked else row.name, *row.cells[1:])
            for row in outcome.rows
        ]
        console.print(make_table(f'{outcome.title}: {outcome.data}', HEADINGS, rows))


def _markdown(outcome: Outcome) -> str:
    """Return the rows of an outcome as a Markdown table, for documentation."""
    parts = [f'### {outcome.title}', '', f'{outcome.data}.', '']
    if outcome.skipped:
        return '\n'.join([*parts, f'Skipped: {outcome.skipped}', ''])
    parts += [f'| {" | ".join(HEADINGS)} |', '|---|---:|---:|---|']
    parts += [f'| {" | ".join(row.cells)} |' for row in outcome.rows]
    return '\n'.join([*parts, ''])


def value_text(value: Value) -> str:
    """Return a value as text: mean, spread and number of values."""
    if not value.count:
        return '-'
    if value.count == 1:
        return number(value.mean)
    # Rounding leaves a tiny spread of equal values.
    spread = value.spread if value.spread > 1e-9 * abs(value.mean) else 0.0
    return f'{number(value.mean)} ± {number(spread)} ({value.count} {value.over})'


def number(value: float) -> str:
    """Return a number with three significant digits, large ones in groups."""
    if not math.isfinite(value):
        return '-'
    if abs(value) >= 1e6:
        return f'{value:.3g}' if abs(value) >= 1e8 else f'{value:,.0f}'
    if abs(value) >= 1000 or value == round(value):
        return f'{value:,.0f}'
    return f'{value:.3g}'


def mark(simulated: bool) -> str:
    """Return the word for the origin of the data in titles."""
    return 'simulated' if simulated else 'recorded'


def plot_forces(
    ax: Axes,
    known: TrialEstimate,
    curves: Mapping[Any, TrialEstimate],
    origin_us: float,
    span_s: tuple[float, float],
    *,
    simulated: bool,
) -> None:
    """Plot estimates of one trial over the known force.

    Args:
        ax: Axes.
        known: Any estimate of the trial.
        curves: Estimates by how their models appear (`label` and `colour`).
        origin_us: Time zero of the plot, camera clock [us].
        span_s: Part that is shown [s].
        simulated: Whether the trial is simulated.
    """
    name = 'true force' if simulated else 'reference'
    lines = [(known.t_us, known.known, name, TRUTH, 2.2)]
    lines += [(e.t_us, e.force, look.label, look.colour, 1.1) for look, e in curves.items()]
    for t_us, force, label, colour, width in lines:
        t_s = 1e-6 * (t_us - origin_us)
        shown = (t_s >= span_s[0]) & (t_s <= span_s[1])
        ax.plot(t_s[shown], force[shown], color=colour, label=label, lw=width, alpha=0.9)
    ax.set_xlim(*span_s)
