# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac bench infer`: what an estimate costs, in time and in operations."""

from __future__ import annotations

import json as json_format
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

import typer
from rich.console import Console
from rich.table import Table

if TYPE_CHECKING:
    from mixtac_bringup.benchmark.infer_run import PacedRun

OptionalPath = Optional[Path]  # noqa: UP045  (typer evaluates this under Python 3.10)


def infer(
    model: Annotated[Optional[str], typer.Option(help='Weight file or name.')] = None,  # noqa: UP045
    seconds: Annotated[float, typer.Option(min=3, max=600, help='Length of the run.')] = 20.0,
    preset: Annotated[str, typer.Option(help='easy, paper_like or hard.')] = 'paper_like',
    json: Annotated[OptionalPath, typer.Option(help='Write the figures there as well.')] = None,
) -> None:
    """Measure the estimator on one thread: a simulated trial in real time, frames beside it."""
    console = Console()
    with console.status(f'simulating {seconds:g} s, then running them in real time'):
        report = measure(model, seconds, preset)
    _print(console, report)
    if json is not None:
        json.parent.mkdir(parents=True, exist_ok=True)
        json.write_text(json_format.dumps(report, indent=2) + '\n', encoding='utf8')


def measure(model_name: str | None, seconds: float, preset: str) -> dict[str, Any]:
    """Return the figures as JSON-ready values.

    Args:
        model_name: Weight file or name of a model; None for the shipped one.
        seconds: Length of the simulated trial [s].
        preset: How hard the virtual sensor is.

    Raises:
        ModelError: There is no such model.
    """
    # These compile; the command line starts without them.
    from mixtac_bringup.benchmark.infer_run import frame_times_ms, quantiles, run_paced
    from mixtac_bringup.benchmark.infer_scene import make_scene
    from mixtac_fger.model_files import DEFAULT_MODEL, find_model
    from mixtac_fger.network import count_parameters, operations_per_cycle
    from mixtac_fger.warm_up import warm_up
    from mixtac_fger.weights import load_model

    model = load_model(find_model(model_name or DEFAULT_MODEL))
    scene = make_scene(seconds, preset)
    warm_up(model)
    frames_ms = frame_times_ms(model, scene)
    paced = run_paced(model, scene)
    return {
        'step_ms': quantiles(paced.step_ms),
        'frame_ms': quantiles(frames_ms),
        'flops_per_cycle': operations_per_cycle(model.network),
        'parameters': count_parameters(model.network),
        'windows': paced.forces,
        'events_per_s': scene.events / seconds,
        **_live_figures(paced),
    }


def _live_figures(paced: PacedRun) -> dict[str, Any]:
    return {
        'window_cpu_ms': paced.window_cpu_ms,
        'late': paced.late,
        'frames_dropped': paced.frames_dropped,
        'cpu': paced.cpu,
    }


def _print(console: Console, report: dict[str, Any]) -> None:
    table = Table(title='One estimate, simulated trial in real time')
    table.add_column('figure')
    table.add_column('p50', justify='right')
    table.add_column('p99', justify='right')
    for name, key in (('window step, packet decoded [ms]', 'step_ms'), ('frame [ms]', 'frame_ms')):
        table.add_row(name, *(f'{report[key][part]:.3f}' for part in ('p50', 'p99')))
    console.print(table)
    console.print(
        f'{report["parameters"]:,} parameters, {report["flops_per_cycle"] / 1e6:.1f} MFLOP per'
        f' 40 ms; {report["windows"]} forces, {report["late"]} of them later than 2 ms,'
        f' {report["frames_dropped"]} frames skipped, {100 * report["cpu"]:.0f} % of a core at'
        f' {report["events_per_s"] / 1e6:.2f} Mev/s; {1e3 * report["window_cpu_ms"]:.0f} us of'
        ' processor time per window'
    )
