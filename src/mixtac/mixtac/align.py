# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac align`: fit the clock of the reference force in recordings, and draw the result."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated, Final, cast

import numpy as np
import typer
from rich.console import Console
from rich.progress import track

from mixtac.figures import EVENTS, MARK, REFERENCE, make_table, new_axes, save_figure
from mixtac.options import JsonFile, OptionalPath, ReferenceTopic, one_of
from mixtac_core.events.errors import MixtacError
from mixtac_core.node import topics
from mixtac_core.node.files import write_json
from mixtac_core.recordings.bag import distinct_names, find_bags
from mixtac_fger.alignment.align import Method
from mixtac_fger.alignment.align import align as align_recording
from mixtac_fger.alignment.bags import read_recording, rewrite_bag, write_fit
from mixtac_fger.alignment.clock_fit import ClockFit
from mixtac_fger.alignment.histories import Recording

METHODS: Final = ('taps', 'edges')
CLOSE_S: Final = 0.08
"""Time shown to either side of an anchor."""


def align(
    bags: Annotated[list[Path], typer.Argument(help='Bags, or folders of bags (data sets).')],
    reference: ReferenceTopic = topics.REFERENCE,
    namespace: Annotated[
        str, typer.Option(help="Namespace of the camera's topics.")
    ] = topics.DEFAULT_NAMESPACE,
    method: Annotated[
        str,
        typer.Option(
            help='taps: two synchronising taps; edges: external_edges against reference_edges.',
            callback=one_of(*METHODS),
        ),
    ] = 'taps',
    rewrite: Annotated[
        OptionalPath, typer.Option(help='Folder for copies with the force on the camera clock.')
    ] = None,
    figure: Annotated[OptionalPath, typer.Option(help='Folder for figures.')] = None,
    json: JsonFile = None,
) -> None:
    """Fit the clock of the reference force to the camera's; write the fit beside each bag."""
    found = [bag for path in bags for bag in find_bags(path)]
    if not found:
        raise typer.BadParameter(f'no bag in {", ".join(map(str, bags))}')
    console, shown = Console(markup=False), distinct_names(found)
    results, rows, damages = [], [], []
    for bag in track(found, 'aligning', console=console, disable=len(found) == 1):
        name, began_s, fit, refused, damage = shown[bag], time.perf_counter(), None, '', ''
        try:
            fit, damage = align_bag(
                bag,
                name=name,
                method=cast('Method', method),
                reference=reference,
                namespace=namespace,
                rewrite=rewrite,
                figures=figure,
            )
        except MixtacError as error:
            refused = str(error)
        took_s = time.perf_counter() - began_s
        rows.append([name, *_row(fit, refused), f'{took_s:.2f}'])
        fields = {'bag': name, 'refused': refused, 'seconds': took_s, 'damage': damage}
        results.append(fields | ({} if fit is None else fit.to_fields()))
        damages += [f'warning: {name}: {damage}'] if damage else []
    columns = ('drift [ppm]', 'std. mid-recording [ms]', 'baseline [s]', 'time [s]')
    console.print(make_table('', ('bag', 'method', *columns), rows, words=3))
    for each in damages:
        console.print(each, style='yellow')
    write_json(json, results)
    if any(each['refused'] for each in results):
        raise typer.Exit(1)


def align_bag(
    bag: Path,
    *,
    name: str = '',
    method: Method = 'taps',
    reference: str = topics.REFERENCE,
    namespace: str = f'/{topics.DEFAULT_NAMESPACE}',
    rewrite: Path | None = None,
    figures: Path | None = None,
) -> tuple[ClockFit, str]:
    """Align one bag; return its clock fit, and what of the bag is missing (empty for a sound one).

    Args:
        bag: Folder of the bag.
        name: Name of the figure and the copy; empty for that of the bag.
        method: As in `align.align`.
        reference: Topic of the reference force.
        namespace: Namespace of the camera's topics, with its leading slash.
        rewrite: Folder for a copy of the bag on one clock.
        figures: Folder for the figure.

    Raises:
        MixtacError: The bag cannot be read, or its clocks cannot be aligned.
    """
    name, edges_only = name or bag.name, method == 'edges'
    recording = read_recording(bag, reference, namespace, edges_only=edges_only)
    fit = align_recording(recording, method=method)
    write_fit(fit, bag)
    if rewrite is not None:
        rewrite_bag(bag, fit, rewrite / name, reference, namespace)
    if figures is not None and not edges_only:
        draw_alignment(figures / f'{name}.png', recording, fit, name)
    return fit, recording.damage


def _row(fit: ClockFit | None, refused: str) -> list[str]:
    """Return method, drift, deviation and baseline of a fit as text."""
    if fit is None:
        return ['refused', refused, '', '']
    first, last = fit.anchors[0].camera_us, fit.anchors[-1].camera_us
    return [
        fit.method,
        f'{fit.drift_ppm:+.1f} +- {1e6 * float(fit.covariance[0, 0]) ** 0.5:.1f}',
        f'{1e3 * float(fit.std_at((first + last) // 2)):.2f}',
        f'{(last - first) * 1e-6:.1f}',
    ]


def draw_alignment(path: Path, recording: Recording, fit: ClockFit, title: str) -> None:
    """Draw event rate and aligned force about the first and the last anchor.

    Args:
        path: File to write; its suffix gives the format.
        recording: The aligned recording.
        fit: The clock map.
        title: Title.

    Raises:
        FileError: The file cannot be written.
    """
    figure, axes = new_axes(columns=2, width=11.0)
    figure.suptitle(f'{title}: {fit.method}, {fit.summary()}', x=0.01, ha='left', fontsize=11)
    counts = recording.counts
    event_s = (np.arange(len(counts.counts)) + 0.5) * counts.width_us * 1e-6
    force_s = (fit.to_camera(recording.force_t_s) - counts.start_us) * 1e-6
    for axis, anchor in zip(axes, (fit.anchors[0], fit.anchors[-1]), strict=True):
        at_s = (anchor.camera_us - counts.start_us) * 1e-6
        shown = np.abs(event_s - at_s) < CLOSE_S
        axis.plot(event_s[shown], counts.counts[shown] / counts.width_us, color=EVENTS, lw=0.6)
        axis.set_ylabel('event rate [Mev/s]', color=EVENTS)
        axis.set_xlabel('time since the first event [s]')
        axis.axvline(at_s, color=MARK, lw=0.8, ls='--')
        shown = np.abs(force_s - at_s) < CLOSE_S
        force = axis.twinx()
        force.plot(force_s[shown], recording.force[shown], color=REFERENCE, lw=0.9)
        force.set_ylabel('force [N]', color=REFERENCE)
    save_figure(figure, path)
