# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac bench compose`: the age of the force, from separate processes and from one."""

from __future__ import annotations

import json as json_format
from enum import Enum
from pathlib import Path
from typing import Annotated, Any, Optional

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from mixtac_bringup.benchmark.compose_runs import ForceRun, run_force
from mixtac_bringup.benchmark.pipeline import Load

OptionalPath = Optional[Path]  # noqa: UP045  (typer evaluates this under Python 3.10)
FRAME_INTERVAL_US = 25_000
READING_INTERVAL_US = 1000
AGES = ('force_age_p50_ms', 'force_age_p99_ms', 'force_age_max_ms')


class Kind(Enum):
    """How driver and estimator run."""

    SEPARATE = 'separate'
    ONE = 'one'


def compose(
    seconds: Annotated[float, typer.Option(min=2, help='Length of each run (s).')] = 20,
    repeats: Annotated[int, typer.Option(min=1, help='Runs of each kind, alternating.')] = 3,
    rate: Annotated[float, typer.Option(min=1000, help='Events per second.')] = 1e6,
    only: Annotated[
        Optional[Kind],  # noqa: UP045  (typer evaluates this under Python 3.10)
        typer.Option(help='One kind of run only, for a long measurement.'),
    ] = None,
    json: Annotated[OptionalPath, typer.Option(help='Write the figures there as well.')] = None,
) -> None:
    """Measure how old the force is at a subscriber, from separate processes and from one."""
    load = Load(rate, frame_interval_us=FRAME_INTERVAL_US, reading_interval_us=READING_INTERVAL_US)
    console = Console()
    runs = []
    kinds = [only] if only is not None else list(Kind)
    with console.status('measuring'):
        for _ in range(repeats):
            runs += [run_force(load, seconds, together=kind is Kind.ONE) for kind in kinds]
    console.print(_table(runs))
    if json is not None:
        json.write_text(json_format.dumps(report(runs, rate), indent=2) + '\n')


def report(runs: list[ForceRun], rate: float) -> dict[str, Any]:
    """Return medians of each kind and all runs for JSON."""
    summary: dict[str, Any] = {}
    for name, together in (('separate', False), ('single_process', True)):
        kind = [run.as_dict() for run in runs if run.together == together]
        if not kind:
            continue
        keys = (*AGES, 'force_rate_hz', 'cpu_total')
        summary[name] = {key: float(np.median([run[key] for run in kind])) for key in keys}
        summary[name]['windows_missing'] = sum(run['windows_missing'] for run in kind)
    return {
        'simulated_camera': True,
        'events_per_s': rate,
        **summary,
        'runs': [run.as_dict() for run in runs],
    }


def _table(runs: list[ForceRun]) -> Table:
    table = Table(
        title='Age of the force at a subscriber: arrival less the end of its window '
        '(simulated camera)',
        title_justify='left',
    )
    headings = ('processes', 'p50 ms', 'p99 ms', 'max ms', 'Hz', 'windows missing', 'CPU')
    for heading in headings:
        table.add_column(heading, justify='left' if heading == 'processes' else 'right')
    for run in sorted(runs, key=lambda each: each.together):
        figures = run.figures
        table.add_row(
            'one' if run.together else 'separate',
            *(f'{figures[key]:.2f}' for key in AGES),
            f'{figures["force_rate_hz"]:.1f}',
            f'{figures["windows_missing"]:.0f}',
            f'{100 * sum(run.cpu.values()):.0f} %',
        )
    return table
