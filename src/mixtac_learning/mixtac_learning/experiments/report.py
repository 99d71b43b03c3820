# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Outcomes of experiments: rows beside the paper's values, as JSON, Markdown and tables."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from mixtac_learning.judge.report import make_table
from mixtac_node.files import read_data, write_json, write_text

HEADINGS = ('what', 'ours', 'paper', 'unit')


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
    def cells(self) -> tuple[str, str, str, str]:
        """The row as text, by `HEADINGS`."""
        paper = '' if self.paper is None else number(self.paper)
        return self.name, str(self.ours), paper, self.unit


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
        table: A table as the paper prints it, headings first; empty for none.
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
            'rows': [asdict(row) | {'ours': row.ours.as_dict()} for row in self.rows],
            'figures': {caption: path.name for caption, path in self.figures.items()},
        }


def texts(name: str) -> dict[str, Any]:
    """Return the fields of `Outcome` that `texts.yaml` gives for an experiment.

    Experiments that draw the forces of models also have a `caption` of their figure.
    """
    found: dict[str, Any] = read_data(Path(__file__).with_name('texts.yaml'))[name]
    return {'name': name, **found, 'deviations': tuple(found['deviations'])}


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
    experiments = [outcome.as_dict() for outcome in outcomes]
    rows = [{'experiment': each['name']} | row for each in experiments for row in each['rows']]
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
            (
                f'{row.name}, simulated' if row.simulated and row.ours.count else row.name,
                *row.cells[1:],
            )
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


def number(value: float) -> str:
    """Return a number with three significant digits, large ones in groups; `-` for NaN."""
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
