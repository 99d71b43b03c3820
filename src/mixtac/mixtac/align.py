# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac align`: fit the clock of the reference force in recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import track

from mixtac.figures import make_table
from mixtac.options import JsonFile, Namespace, OptionalPath, ReferenceTopic
from mixtac_core.events.errors import MixtacError
from mixtac_core.node import topics
from mixtac_core.node.files import write_json
from mixtac_core.recordings.bag import distinct_names, find_bags
from mixtac_fger.alignment.align import Method
from mixtac_fger.alignment.align import align as align_recording
from mixtac_fger.alignment.bags import read_recording, rewrite_bag, write_fit
from mixtac_fger.alignment.clock_fit import ClockFit


def align(
    bags: Annotated[list[Path], typer.Argument(help='Bags, or folders of bags (data sets).')],
    reference: ReferenceTopic = topics.REFERENCE,
    namespace: Namespace = topics.DEFAULT_NAMESPACE,
    method: Annotated[
        Method,
        typer.Option(
            help='taps: two synchronising taps; edges: external_edges against reference_edges.'
        ),
    ] = 'taps',
    rewrite: Annotated[
        OptionalPath, typer.Option(help='Folder for copies with the force on the camera clock.')
    ] = None,
    json: JsonFile = None,
) -> None:
    """Fit the clock of the reference force to the camera's; write the fit beside each bag."""
    found = [bag for path in bags for bag in find_bags(path)]
    if not found:
        remedy = 'give a bag or a folder of bags'
        raise MixtacError(f'no bag in {", ".join(map(str, bags))}', remedy=remedy)
    console, shown = Console(markup=False), distinct_names(found)
    results, rows = [], []
    for bag in track(found, 'aligning', console=console, disable=len(found) == 1):
        name, fit, refused, damage = shown[bag], None, '', ''
        try:
            copy = rewrite and rewrite / name
            fit, damage = align_bag(bag, method, reference, namespace, copy)
        except MixtacError as error:
            refused = str(error)
        rows.append([name, *_row(fit, refused or damage)])
        fields = {'bag': name, 'refused': refused, 'damage': damage}
        results.append(fields | ({} if fit is None else fit.to_fields()))
    columns = ('bag', 'drift [ppm]', 'std. mid-recording [ms]', 'baseline [s]', 'remarks')
    console.print(make_table('', columns, rows))
    write_json(json, results)
    if any(each['refused'] for each in results):
        raise typer.Exit(1)


def align_bag(
    bag: Path,
    method: Method = 'taps',
    reference: str = topics.REFERENCE,
    namespace: str = f'/{topics.DEFAULT_NAMESPACE}',
    copy: Path | None = None,
) -> tuple[ClockFit, str]:
    """Align one bag; return its clock fit, and what of the bag is missing (empty for a sound one).

    Args:
        bag: Folder of the bag.
        method: As in `align.align`.
        reference: Topic of the reference force.
        namespace: Namespace of the camera's topics, with its leading slash.
        copy: Folder of a copy of the bag on one clock; None for none.

    Raises:
        MixtacError: The bag cannot be read, or its clocks cannot be aligned.
    """
    recording = read_recording(bag, reference, namespace, edges_only=method == 'edges')
    fit = align_recording(recording, method=method)
    write_fit(fit, bag)
    if copy is not None:
        rewrite_bag(bag, fit, copy, reference, namespace)
    return fit, recording.damage


def _row(fit: ClockFit | None, remark: str) -> list[str]:
    """Return drift, deviation and baseline of a fit as text, and a remark."""
    if fit is None:
        return ['', '', '', f'refused: {remark}']
    first, last = fit.anchors[0].camera_us, fit.anchors[-1].camera_us
    return [
        f'{fit.drift_ppm:+.1f} +- {1e6 * float(fit.covariance[0, 0]) ** 0.5:.1f}',
        f'{1e3 * float(fit.std_at((first + last) // 2)):.2f}',
        f'{(last - first) * 1e-6:.1f}',
        remark,
    ]
