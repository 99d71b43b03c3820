# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac export | inspect | repair`: recordings as other files, and their contents."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from mixtac_recordings.bag_writer import repair as repair_bag
from mixtac_recordings.export import export_recording
from mixtac_recordings.recording import AEDAT4_SUFFIX, DamagedRecordingError
from mixtac_recordings.summary import summarise


def export(
    recording: Annotated[Path, typer.Argument(help='Folder of a bag, .mcap, .db3 or .aedat4.')],
    to: Annotated[str, typer.Option(help='aedat4, csv or npz.')],
    out: Annotated[Path, typer.Option(help='New folder for the files.')],
) -> None:
    """Write events, frames, inertial samples, edges and forces of a recording to other files."""
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
        console.print('AEDAT4 cannot hold forces: export them with --to csv or npz')
    for topic, count in counts.wrenches.items():
        console.print(f'{topic}: {count} wrenches')
    if counts.damage:
        console.print(f'warning: {counts.damage}', style='yellow', markup=False)


def inspect(
    bag: Annotated[Path, typer.Argument(help='Folder of a bag, .mcap, .db3 or .aedat4.')],
) -> None:
    """List the topics of a recording, decode all events and count lost packets.

    Exit status 1 if the recording is incomplete.
    """
    summary = summarise(bag)
    table = Table(title=f'{bag}, {summary.duration_s:.1f} s', title_justify='left')
    for heading in ('topic', 'type', 'messages', 'events', 'lost packets'):
        table.add_column(heading, justify='left' if heading in ('topic', 'type') else 'right')
    for topic, count in sorted(summary.counts.items()):
        events = summary.events.get(topic)
        table.add_row(
            topic,
            summary.types[topic],
            str(count),
            str(events.events) if events else '',
            str(events.lost_packets) if events else '',
        )
    Console().print(table)
    if summary.damage:
        raise DamagedRecordingError(f'{bag}: {summary.damage}')


def repair(
    recording: Annotated[Path, typer.Argument(help='Folder of a bag, .mcap, .db3 or .aedat4.')],
    out: Annotated[Path, typer.Option(help='New folder for the repaired recording.')],
) -> None:
    """Write what is whole of a damaged recording as a new one, and say what is missing.

    Bags become MCAP with an index, checksums and metadata.yaml; AEDAT4 files stay AEDAT4.
    """
    console = Console()
    if recording.suffix == AEDAT4_SUFFIX:
        counts = export_recording(recording, 'aedat4', out)
        damage = counts.damage
        console.print(f'{out}: {counts.events} events, {counts.frames} frames')
    else:
        repaired = repair_bag(recording, out)
        damage = repaired.damage
        console.print(f'{out}: {sum(repaired.counts.values())} messages')
        for topic, count in sorted(repaired.counts.items()):
            console.print(f'{topic}: {count} messages')
    if damage:
        console.print(f'warning: {damage}', style='yellow', markup=False)
