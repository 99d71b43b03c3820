# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The commands `experiments models` and `adaptation`; torch is imported once they run."""

from __future__ import annotations

import json as json_module
from pathlib import Path
from typing import Annotated, List, Optional  # noqa: UP035  (as below)

import typer
from rich.console import Console
from rich.progress import Progress

from mixtac_fger.errors import ConfigError
from mixtac_fger.model_files import DEFAULT_MODEL, find_model

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

    from mixtac_fger.experiments.job import Job
    from mixtac_fger.experiments.suite import ALL_ROWS, CHOICES, ROWS, SIZES, UNTRAINED
    from mixtac_fger.experiments.table import aggregate, as_markdown, as_table
    from mixtac_fger.train.run_config import OURS

    if quick:
        size, seeds = 'quick', 1
    chosen = list(model or ((OURS, *CHOICES) if choices else ROWS))
    unknown = [name for name in chosen if name not in ALL_ROWS]
    if unknown or size not in SIZES:
        raise ConfigError(f'model {unknown or ""} size {size!r}: choose {ALL_ROWS}; {tuple(SIZES)}')
    torch.set_num_threads(1)
    console = Console()
    work = [
        Job(SIZES[size], size, name, seed, out)
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

    from mixtac_fger.experiments.adaptation import adaptation_study
    from mixtac_fger.judge.tables import show_figures
    from mixtac_fger.weights import load_model

    torch.set_num_threads(1)
    console = Console()
    found = adaptation_study(load_model(find_model(model)), sensors, out / 'trials', console.print)
    rows = {name: row for name, row in found.items() if isinstance(row, dict)}
    show_figures(console, f'dynamic trials of {sensors} unseen sensors, simulated', rows)
    console.print(f'chosen: {", ".join(found["ways"])}')
    if json is not None:
        content = {'model': model, 'sensors': sensors, 'simulated': True} | found
        json.write_text(json_module.dumps(content, indent=2) + '\n', encoding='utf-8')
