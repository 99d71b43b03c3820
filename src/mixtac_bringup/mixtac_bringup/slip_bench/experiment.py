# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The command `mixtac experiments grasps`: the paper's trials with cup, box and ball, simulated."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

import typer

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray
    from rich.console import Console

    from mixtac_bringup.slip_bench.trial import TrialPlan, TrialResult
    from mixtac_sim.grasp.objects import ObjectName

    Floats = NDArray[np.float64]

OptionalPath = Optional[Path]  # noqa: UP045  (typer evaluates this under Python 3.10)
PAPER_MM = {'cup': 0.90, 'box': 0.71, 'ball': 10.03}
"""Mean displacement in the paper [mm]."""
PAPER_TRIALS: dict[ObjectName, int] = {'cup': 20, 'box': 15, 'ball': 20}
FIRST_SEED = 80_000


def slip(
    figures: Annotated[OptionalPath, typer.Option(help='Folder for the figures.')] = None,
    share: Annotated[float, typer.Option(help="Share of the paper's numbers of trials.")] = 1.0,
    margin: Annotated[float, typer.Option(help='Grasp force over the least that holds.')] = 1.05,
    preset: Annotated[str, typer.Option(help='How hard the sensors are.')] = 'paper_like',
    keep: Annotated[
        OptionalPath, typer.Option(help='Keep finished trials in this file and go on from them.')
    ] = None,
    report: Annotated[OptionalPath, typer.Option('--json', help='Write the result.')] = None,
) -> None:
    """Hold cup, box and ball against the paper's blow, simulated, beside the paper's numbers."""
    from rich.console import Console
    from rich.progress import track

    from mixtac_bringup.slip_bench.kept import Kept
    from mixtac_bringup.slip_bench.kept_trials import kept_trial
    from mixtac_bringup.slip_bench.report import summary
    from mixtac_bringup.slip_bench.trial import TrialPlan

    console, kept = Console(), Kept(keep)
    outcome: dict[str, Any] = {'simulated': True, 'margin': margin, 'preset': preset}
    curves: dict[str, list[Floats]] = {}
    for at, (name, number) in enumerate(PAPER_TRIALS.items()):
        numbers = range(max(round(share * number), 1))
        plans = [
            TrialPlan(name, FIRST_SEED + 1000 * at + k, margin=margin, preset=preset)
            for k in numbers
        ]
        trials = [kept_trial(plan, kept) for plan in track(plans, name, console=console)]
        results = [result for result, _ in trials]
        curves[name] = [curve for _, curve in trials]
        if figures is not None:
            _draw_typical(figures, plans, results)
        outcome[name] = {
            **summary(results),
            'paper_mean_mm': PAPER_MM[name],
            'each': [result.as_dict() for result in results],
        }
    if figures is not None:
        from mixtac_bringup.slip_bench.figures import draw_objects

        draw_objects(figures / 'slip_objects.png', curves, PAPER_MM)
    _print(console, outcome, list(PAPER_TRIALS))
    if report is not None:
        report.write_text(json.dumps(outcome, indent=2) + '\n', encoding='utf-8')


def _draw_typical(figures: Path, plans: list[TrialPlan], results: list[TrialResult]) -> None:
    """Run the trial with the median slip once more and draw it."""
    from mixtac_bringup.slip_bench.figures import draw_trial
    from mixtac_bringup.slip_bench.trial import run_trial

    figures.mkdir(parents=True, exist_ok=True)
    order = sorted(range(len(results)), key=lambda k: results[k].slip_mm)
    plan = plans[order[len(order) // 2]]
    draw_trial(figures / f'slip_{plan.name}.png', *run_trial(plan))


def _print(console: Console, outcome: dict[str, Any], names: Sequence[str]) -> None:
    from rich.table import Table

    table = Table(title='Displacement, simulated; the paper measured 0.32 mm in 13 ms with one box')
    headings = ('object', 'trials', 'held', 'without control', 'mean mm', 'median mm', 'paper mean')
    for heading in (*headings, 'floor mm', 'arrest ms', 'floor ms'):
        table.add_column(heading)
    for name in names:
        row = outcome[name]
        cells = (
            row['trials'],
            f'{100 * row["held_fraction"]:.0f} %',
            f'{100 * row["open_loop_held_fraction"]:.0f} %',
            row['slip_mm']['mean'],
            row['slip_mm']['median'],
            row['paper_mean_mm'],
            row['floor_slip_mm']['median'],
            row['arrest_ms']['median'],
            row['floor_arrest_ms']['median'],
        )
        table.add_row(name, *(str(cell) for cell in cells))
    console.print(table)
