# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Reports of experiments: JSON, Markdown, one HTML file, and the style of the figures."""

from __future__ import annotations

import base64
import html
import json
import math
from typing import TYPE_CHECKING, Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from mixtac_lab.experiments.training import EVENTS, FGER, FRAMES, FUSION
from mixtac_learning.train.config import OURS

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from matplotlib.axes import Axes

    from mixtac_lab.experiments.harness import Outcome, Row, Value


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


def write_json(path: Path, outcomes: Sequence[Outcome], run: Mapping[str, Any]) -> None:
    """Write `rows` of all experiments, and each with its data, figures and deviations.

    Args:
        path: File.
        outcomes: Of the experiments.
        run: What was run: command, sizes, seeds, versions.
    """
    rows = [
        {'experiment': outcome.name} | row.as_dict() for outcome in outcomes for row in outcome.rows
    ]
    content = {
        'run': dict(run),
        'rows': rows,
        'experiments': [outcome.as_dict() for outcome in outcomes],
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content, indent=1) + '\n', encoding='utf-8')


def write_html(path: Path, outcomes: Sequence[Outcome], run: Mapping[str, Any]) -> None:
    """Write the report as one file; arguments as in `write_json`."""
    told = ''.join(
        f'<tr><th>{_text(key)}</th><td>{_text(value)}</td></tr>' for key, value in run.items()
    )
    links = ' · '.join(f'<a href="#{o.name}">{_text(o.title)}</a>' for o in outcomes)
    body = ''.join(_section(outcome) for outcome in outcomes)
    path.write_text(
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width">'
        f'<title>Mixtac experiments</title><style>{_STYLE}</style></head><body>'
        "<h1>The paper's experiments</h1>"
        '<p class="small">Our numbers are means, with the standard deviation over what the line'
        ' says. Lines marked <span class="simulated">simulated</span> are of the virtual sensor and'
        ' say nothing about a real one.</p>'
        f'<table>{told}</table><p>{links}</p>{body}</body></html>\n',
        encoding='utf-8',
    )


def write_markdown(path: Path, outcomes: Sequence[Outcome]) -> None:
    """Write the numbers as Markdown tables, for documentation."""
    parts = []
    for outcome in outcomes:
        parts += [f'### {outcome.title}', '', f'{outcome.data}.', '']
        if outcome.skipped:
            parts += [f'Not carried out: {outcome.skipped}', '']
            continue
        parts += ['| what | ours | paper | unit |', '|---|---:|---:|---|']
        for row in outcome.rows:
            paper = '' if row.paper is None else number(row.paper)
            parts.append(f'| {row.name} | {value_text(row.ours)} | {paper} | {row.unit} |')
        parts.append('')
    path.write_text('\n'.join(parts), encoding='utf-8')


def _section(outcome: Outcome) -> str:
    parts = [
        f'<h2 id="{outcome.name}">{_text(outcome.title)}</h2>',
        f'<p><b>Paper:</b> {_text(outcome.paper)}</p>',
        f'<p><b>Data:</b> {_text(outcome.data)}</p>',
    ]
    if outcome.skipped:
        return ''.join([*parts, f'<p><b>Not carried out:</b> {_text(outcome.skipped)}</p>'])
    parts += [_figure(caption, path) for caption, path in outcome.figures.items()]
    parts += [_table(outcome.table)] if outcome.table else []
    head = ''.join(
        f'<th{kind}>{name}</th>'
        for name, kind in (
            ('what', ''),
            ('ours', ' class="n"'),
            ('paper', ' class="n"'),
            ('unit', ''),
            ('conditions', ''),
        )
    )
    rows = ''.join(map(_row, outcome.rows))
    parts.append(f'<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>')
    if outcome.deviations:
        items = ''.join(f'<li>{_text(each)}</li>' for each in outcome.deviations)
        parts.append(f'<p><b>Different from the paper:</b></p><ul>{items}</ul>')
    return ''.join(parts)


def _table(lines: Sequence[Sequence[str]]) -> str:
    head = ''.join(f'<th>{_text(cell)}</th>' for cell in lines[0])
    body = ''.join(
        f'<tr>{"".join(f"<td>{_text(cell)}</td>" for cell in line)}</tr>' for line in lines[1:]
    )
    return f'<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table><br>'


def _row(row: Row) -> str:
    known = row.ours.count > 0
    label = ' <span class="simulated">simulated</span>' if row.simulated and known else ''
    paper = '' if row.paper is None else number(row.paper)
    place = f'; paper: {row.place}' if row.place else ''
    return (
        f'<tr><td>{_text(row.name)}{label}</td><td class="n">{_text(value_text(row.ours))}</td>'
        f'<td class="n">{_text(paper)}</td><td>{_text(row.unit)}</td>'
        f'<td class="small">{_text(row.conditions + place)}</td></tr>'
    )


def value_text(value: Value) -> str:
    """Return a value for people: mean, spread and over how many."""
    if not value.count:
        return '-'
    if value.count == 1:
        return number(value.mean)
    # What rounding leaves of a spread of nothing is not one.
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


COLOURS = {
    'truth': '#1f1f1f',
    'paper': '#8a8a8a',
    OURS: '#0072b2',
    FGER: '#009e73',
    FRAMES: '#e69f00',
    EVENTS: '#d55e00',
    FUSION: '#cc79a7',
}
"""By model; told apart without colour vision (Okabe and Ito 2008)."""
DPI = 110


def new_figure(
    columns: int = 1, rows: int = 1, width: float = 8.0, height: float = 3.4
) -> tuple[Figure, list[Axes]]:
    """Return a figure and its axes, row by row; sizes in inches."""
    figure = Figure(figsize=(width, height), layout='constrained')
    axes = figure.subplots(rows, columns, squeeze=False)
    flat = [ax for row in axes for ax in row]
    for ax in flat:
        ax.spines[['top', 'right']].set_visible(False)
        ax.grid(visible=True, alpha=0.25, linewidth=0.6)
        ax.set_axisbelow(True)
    return figure, flat


def save_figure(figure: Figure, path: Path) -> Path:
    """Write a figure and return where."""
    FigureCanvasAgg(figure)
    figure.savefig(path, dpi=DPI)
    return path


def mark(simulated: bool) -> str:
    """Return what titles say of where the data come from."""
    return 'simulated' if simulated else 'recorded'
