# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac export | import | inspect | repair`: convert, list and repair recordings."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.markup import escape

from mixtac.figures import make_table
from mixtac.options import OptionalPath, Profile, Split
from mixtac_core.node.topics import REFERENCE
from mixtac_core.recordings.bag_writer import repair as repair_bag
from mixtac_core.recordings.dataset import FILE_NAME, add_recording, read_recordings
from mixtac_core.recordings.export import WRITERS, export_recording
from mixtac_core.recordings.importing import import_recording
from mixtac_core.recordings.recording import FORMATS, DamagedRecordingError, Selection
from mixtac_core.recordings.summary import summarise
from mixtac_core.recordings.tables import TableOptions
from mixtac_fger.alignment.bags import write_fit
from mixtac_fger.alignment.clock_fit import ClockFit

_EVENTS = 'Topic of events, camera in an AEDAT4 file, or group in an HDF5 file; none omits them.'
EventsOf = Annotated[str, typer.Option('--events', help=_EVENTS)]
ImageOf = Annotated[str, typer.Option('--image', help='Topic of frames; none omits them.')]
ImuOf = Annotated[str, typer.Option('--imu', help='Topic of inertial samples; none omits them.')]
_TIME_UNIT = 'Unit of camera times that the file does not state: ns, us, ms, s. Empty: whole us.'
TimeUnit = Annotated[str, typer.Option(help=_TIME_UNIT)]
_SIZE = 'Size of the camera in pixels, as 346x260, if the file states none. Empty: that of frames.'
Size = Annotated[str, typer.Option(help=_SIZE)]
_FORCE_UNIT = 'Unit of the times of forces that the file does not state. Empty: s.'
_SOURCE = '.csv, .txt, .npz, .h5, .aedat4, .aedat, .bag, a bag, or a folder of `mixtac export`.'


def export(
    recording: Annotated[Path, typer.Argument(help='A bag, or any file that import reads.')],
    to: Annotated[str, typer.Option(help=f'{", ".join(WRITERS)}.')],
    out: Annotated[Path, typer.Option(help='New folder for the files.')],
    events: EventsOf = '',
    image: ImageOf = '',
    imu: ImuOf = '',
) -> None:
    """Write events, frames, inertial samples, edges and forces of a recording to other files."""
    console = Console(markup=False)
    with console.status(escape(f'reading {recording}')):
        counts = export_recording(recording, to, out, Selection(events, image, imu))
    console.print(
        f'{out}: {counts.events} events, {counts.frames} frames, {counts.samples} inertial samples,'
        f' {counts.edges} edges'
    )
    if to == 'aedat4':
        console.print('AEDAT4 cannot hold forces: export them with --to csv, hdf5 or npz')
    for topic, count in counts.wrenches.items():
        console.print(f'{topic}: {count} wrenches')
    _warn(console, [counts.info.damage, *counts.warnings()])


def _warn(console: Console, warnings: list[str]) -> None:
    for each in filter(None, warnings):
        console.print(f'warning: {each}', style='yellow')


def import_(
    source: Annotated[Path, typer.Argument(help=_SOURCE)],
    out: Annotated[Path, typer.Option(help='Folder of the new bag.')],
    forces: Annotated[
        OptionalPath, typer.Option(help='Table of the reference force: .csv or .npz.')
    ] = None,
    same_clock: Annotated[
        bool, typer.Option('--same-clock', help='The forces are stamped on the camera clock.')
    ] = False,
    time_unit: TimeUnit = '',
    force_unit: Annotated[str, typer.Option(help=_FORCE_UNIT)] = '',
    size: Size = '',
    profile: Profile = '',
    split: Split = '',
    events: EventsOf = '',
    image: ImageOf = '',
    imu: ImuOf = '',
) -> None:
    """Make a bag from events, frames and forces in CSV, NPZ, HDF5 or AEDAT4 files."""
    options = TableOptions(time_unit, force_unit, _size(size))
    if profile or split:
        read_recordings(out.absolute().parent / FILE_NAME)
    console, selection = Console(markup=False), Selection(events, image, imu)
    with console.status(escape(f'reading {source}')):
        counts = import_recording(
            source, out, forces=forces, same_clock=same_clock, options=options, selection=selection
        )
    wrenches = counts.wrenches.get(REFERENCE, 0)
    console.print(f'{out}: {counts.events} events, {counts.frames} frames, {wrenches} forces')
    console.print(
        f'{counts.seconds:.3f} s, {counts.events / max(counts.seconds, 1e-6):.3g} events/s, times'
        f' on a grid of {counts.grid_us} us, {counts.info.width} x {counts.info.height} pixels'
    )
    if same_clock and wrenches:
        one = ClockFit(1.0, 0.0, np.zeros((2, 2)), 0, 0.0, (), np.zeros(0), method='one clock')
        console.print(f'clock fit: {write_fit(one, out)}')
    elif wrenches:
        console.print(f'the forces are on a clock of their own: next, mixtac align {out}')
    if profile or split:
        figures: dict[str, object] = {'events': counts.events, 'frames': counts.frames}
        figures |= {'forces': wrenches, 'imported_from': source.name}
        console.print(f'described in {add_recording(out, figures, profile=profile, split=split)}')
    lacking = [] if counts.frames else ['no frames: the force cannot be estimated']
    _warn(console, [*lacking, counts.info.damage, *counts.warnings()])


def _size(text: str) -> tuple[int, int] | None:
    match = re.fullmatch(r'(\d+)x(\d+)', text)
    if text and match is None:
        raise typer.BadParameter(f'{text!r}: give columns and rows like 346x260')
    return (int(match[1]), int(match[2])) if match else None


def inspect(
    bag: Annotated[
        OptionalPath, typer.Argument(help='A bag, or any file that import reads.')
    ] = None,
    time_unit: TimeUnit = '',
    size: Size = '',
    formats: Annotated[
        bool, typer.Option('--formats', help='List known file formats; not all can be read.')
    ] = False,
) -> None:
    """List the topics of a recording, read all of it, decode the events and count lost packets.

    Exit status 1 if the recording is incomplete or damaged.
    """
    console = Console(markup=False)
    if formats:
        known = [(each.name, ' '.join(each.suffixes), each.remedy or 'read') for each in FORMATS]
        title = 'read by inspect, import, export and up --device; or what to do instead'
        console.print(make_table(title, ('format', 'suffixes', 'way'), known, words=3))
        return
    if bag is None:
        raise typer.BadParameter('give a recording, or --formats')
    summary = summarise(bag, TableOptions(time_unit, size=_size(size)))
    rows = []
    for topic, count in sorted(summary.counts.items()):
        events = summary.events.get(topic)
        counted = (events.events, events.lost.packets_missing) if events else ('', '')
        rows.append((topic, summary.types[topic], count, *counted))
    headings = ('topic', 'type', 'messages', 'events', 'lost packets')
    console.print(make_table(f'{bag}, {summary.duration_s:.1f} s', headings, rows, words=2))
    _warn(console, summary.warnings)
    if summary.damage:
        raise DamagedRecordingError(f'{bag}: {summary.damage}')


def repair(
    recording: Annotated[Path, typer.Argument(help='Folder of a bag, .mcap or .db3.')],
    out: Annotated[Path, typer.Option(help='New folder for the repaired bag.')],
) -> None:
    """Write the intact part of a damaged bag to a new bag, and report what is missing.

    The new bag is in MCAP with an index, checksums and metadata.yaml.
    """
    console = Console(markup=False)
    counts, damage = repair_bag(recording, out)
    console.print(f'{out}: {counts.total()} messages')
    for topic, count in sorted(counts.items()):
        console.print(f'{topic}: {count} messages')
    _warn(console, [damage])
