# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac export`: a recording as AEDAT4, CSV or NPZ."""

from __future__ import annotations

from pathlib import Path  # noqa: TC003  (typer reads it)
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn


def export(
    recording: Annotated[Path, typer.Argument(help='Folder of a bag, .mcap, .db3 or .aedat4.')],
    to: Annotated[str, typer.Option(help='aedat4, csv or npz.')],
    out: Annotated[Path, typer.Option(help='New folder for the files.')],
) -> None:
    """Write events, frames, inertial samples, edges and forces of a recording to other files."""
    from mixtac_bringup.export.export import export_recording

    console = Console()
    columns = (TextColumn('{task.description}'), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console) as bars:
        bar = bars.add_task(str(recording), total=1.0)
        counts = export_recording(recording, to, out, lambda done: bars.update(bar, completed=done))
    console.print(
        f'{out}: {counts.events} events, {counts.frames} frames, {counts.samples} inertial '
        f'samples, {counts.edges} edges'
    )
    if to == 'aedat4':
        console.print('AEDAT4 has no place for forces: export those with --to csv or npz')
    for topic, count in counts.wrenches.items():
        console.print(f'{topic}: {count} wrenches')
