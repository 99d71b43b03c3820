# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Outcomes of experiments, their reports as JSON, Markdown and HTML, and the style of figures."""

from __future__ import annotations

import base64
import html
import math
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.table import Table

from mixtac_node.files import write_json, write_text

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

    from rich.console import Console


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


_STYLE = """
:root { color-scheme: light; }
body { font: 15px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem;
  color: #1f1f1f; background: #fff; }
h1 { font-size: 1.6rem; margin-bottom: .2rem; } h2 { margin-top: 2.6rem; font-size: 1.25rem;
  border-bottom: 1px solid #ddd; padding-bottom: .2rem; }
table { border-collapse: collapse; width: 100%; font-size: .88rem; }
th, td { text-align: left; padding: .28rem .6rem .28rem 0; border-bottom: 1px solid #eee;
  vertical-align: top; }
th { border-bottom: 1px solid #999; } td.n, th.n { text-align: right; white-space: nowrap; }
figure { margin: 1.2rem 0; } img { max-width: 100%; height: auto; }
figcaption, .small { color: #555; font-size: .85rem; }
.simulated { background: #fff3d6; border-radius: .3em; padding: 0 .35em; font-size: .78rem; }
li { margin: .2rem 0; }
"""


HEADINGS = ('what', 'ours', 'paper', 'unit')


def cells(row: Row) -> tuple[str, str, str, str]:
    """Return a row as text, by `HEADINGS`."""
    paper = '' if row.paper is None else number(row.paper)
    return row.name, value_text(row.ours), paper, row.unit


def write(
    folder: Path, outcomes: Sequence[Outcome], run: Mapping[str, Any], json: Path | None = None
) -> None:
    """Write `report.html`, `report.md` and `report.json`.

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
    for path in (folder / 'report.json', *([] if json is None else [json])):
        write_json(path, content)
    write_text(folder / 'report.md', '\n'.join(map(_markdown, outcomes)))
    write_text(folder / 'report.html', _html(outcomes, run))


def show(console: Console, outcomes: Sequence[Outcome]) -> None:
    """Print the rows of all outcomes as tables."""
    for outcome in outcomes:
        if outcome.skipped:
            console.print(f'{outcome.title} skipped: {outcome.skipped}')
            continue
        table = Table(title=f'{outcome.title}: {outcome.data}', title_justify='left')
        for heading in HEADINGS:
            table.add_column(heading, justify='left' if heading in {'what', 'unit'} else 'right')
        for row in outcome.rows:
            name, *others = cells(row)
            table.add_row(name + (', simulated' if row.marked else ''), *others)
        console.print(table)


def _markdown(outcome: Outcome) -> str:
    """Return the rows of an outcome as a Markdown table, for documentation."""
    parts = [f'### {outcome.title}', '', f'{outcome.data}.', '']
    if outcome.skipped:
        return '\n'.join([*parts, f'Skipped: {outcome.skipped}', ''])
    parts += [f'| {" | ".join(HEADINGS)} |', '|---|---:|---:|---|']
    parts += [f'| {" | ".join(cells(row))} |' for row in outcome.rows]
    return '\n'.join([*parts, ''])


def _html(outcomes: Sequence[Outcome], run: Mapping[str, Any]) -> str:
    """Return a report in one file, figures included."""
    about = ''.join(
        f'<tr><th>{_text(key)}</th><td>{_text(value)}</td></tr>' for key, value in run.items()
    )
    links = ' · '.join(f'<a href="#{o.name}">{_text(o.title)}</a>' for o in outcomes)
    body = ''.join(_section(outcome) for outcome in outcomes)
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width">'
        f'<title>Mixtac experiments</title><style>{_STYLE}</style></head><body>'
        "<h1>The paper's experiments</h1>"
        '<p class="small">Our values are means with standard deviations; each row names what they'
        ' are taken over. Rows marked <span class="simulated">simulated</span> come from the'
        ' virtual sensor and prove nothing about a real one.</p>'
        f'<table>{about}</table><p>{links}</p>{body}</body></html>\n'
    )


def _section(outcome: Outcome) -> str:
    parts = [
        f'<h2 id="{outcome.name}">{_text(outcome.title)}</h2>',
        f'<p><b>Paper:</b> {_text(outcome.paper)}</p>',
        f'<p><b>Data:</b> {_text(outcome.data)}</p>',
    ]
    if outcome.skipped:
        return ''.join([*parts, f'<p><b>Skipped:</b> {_text(outcome.skipped)}</p>'])
    parts += [_figure(caption, path) for caption, path in outcome.figures.items()]
    if outcome.table:
        lines = [''.join(f'<td>{_text(cell)}</td>' for cell in line) for line in outcome.table[1:]]
        parts.append(_table(outcome.table[0], lines) + '<br>')
    parts.append(_table((*HEADINGS, 'conditions'), [_row(row) for row in outcome.rows]))
    if outcome.deviations:
        items = ''.join(f'<li>{_text(each)}</li>' for each in outcome.deviations)
        parts.append(f'<p><b>Differences from the paper:</b></p><ul>{items}</ul>')
    return ''.join(parts)


def _table(headings: Sequence[str], lines: Sequence[str]) -> str:
    head = ''.join(f'<th>{_text(heading)}</th>' for heading in headings)
    body = ''.join(f'<tr>{line}</tr>' for line in lines)
    return f'<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>'


def _row(row: Row) -> str:
    name, ours, paper, unit = map(_text, cells(row))
    label = ' <span class="simulated">simulated</span>' if row.marked else ''
    place = f'; paper: {row.place}' if row.place else ''
    return (
        f'<td>{name}{label}</td><td class="n">{ours}</td><td class="n">{paper}</td>'
        f'<td>{unit}</td><td class="small">{_text(row.conditions + place)}</td>'
    )


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


def _figure(caption: str, path: Path) -> str:
    data = base64.b64encode(path.read_bytes()).decode()
    words = html.escape(caption)
    return (
        f'<figure><img alt="{words}" src="data:image/png;base64,{data}">'
        f'<figcaption>{words}</figcaption></figure>'
    )


def _text(value: object) -> str:
    return html.escape(str(value))
