# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The command `mixtac align`."""

from __future__ import annotations

import json
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Optional, cast

import typer

from mixtac_events.errors import MixtacError

if TYPE_CHECKING:
    from rich.table import Table

    from mixtac_alignment.clock_fit import ClockFit
    from mixtac_alignment.sensor_pool import SensorTiming
    from mixtac_bringup.align.bag_recording import Method

METHODS: Final = ('refined', 'two_impulse', 'paper', 'edges')
OptionalPath = Optional[Path]  # noqa: UP045  (typer evaluates this under Python 3.10)


@dataclass(frozen=True, slots=True)
class Options:
    """What to do with every bag.

    Attributes:
        reference: Topic of the reference force.
        namespace: Namespace of the camera's topics.
        method: As in `BagRecording.fit`.
        pooled: Whether the bags of one sensor help each other.
        rewritten: Folder for bags on one clock; none for none.
        figures: Folder for figures; none for none.
    """

    reference: str
    namespace: str
    method: Method
    pooled: bool
    rewritten: Path | None
    figures: Path | None


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of a bag.

    Attributes:
        bag: Its name.
        fit: Its clock map, if any.
        reason: Why there is none.
        seconds: How long it took.
    """

    bag: str
    fit: ClockFit | None
    reason: str
    seconds: float


def align(
    bags: Annotated[list[Path], typer.Argument(help='Bags, or folders of bags (data sets).')],
    reference: Annotated[str, typer.Option(help='Topic of the reference force.')] = (
        '/ft_sensor/wrench'
    ),
    namespace: Annotated[str, typer.Option(help="Namespace of the camera's topics.")] = '/mixtac',
    method: Annotated[
        str,
        typer.Option(
            help='refined; two_impulse: the taps alone; paper: their troughs and peaks alone; '
            'edges: external_edges against reference_edges, in place of taps.'
        ),
    ] = 'refined',
    pool: Annotated[
        bool, typer.Option(help='Let bags of one sensor tell of its gel and its latency together.')
    ] = True,
    rewrite: Annotated[
        OptionalPath, typer.Option(help='Folder for copies with the force on the camera clock.')
    ] = None,
    figure: Annotated[OptionalPath, typer.Option(help='Folder for figures.')] = None,
    report: Annotated[OptionalPath, typer.Option('--json', help='Write the table as JSON.')] = None,
) -> None:
    """Fit the clock of the reference force to the camera's; write the fit beside each bag."""
    from rich.console import Console
    from rich.progress import track

    console = Console()
    if method not in METHODS:
        raise typer.BadParameter(f'method {method!r}: choose one of {", ".join(METHODS)}')
    options = Options(reference, namespace, cast('Method', method), pool, rewrite, figure)
    found = [bag for path in bags for bag in find_bags(path)]
    if not found:
        raise typer.BadParameter(f'no bag in {", ".join(map(str, bags))}')
    quiet = len(found) < 2
    timings = {}
    if pool and not quiet and method in ('refined', 'two_impulse'):
        from mixtac_bringup.align.pooling import sensor_timings

        names = track(found, 'learning the sensors', console=console)
        timings = sensor_timings(names, reference, namespace)
    names = track(found, 'aligning', console=console, disable=quiet)
    outcomes = [align_bag(bag, options, timings.get(bag)) for bag in names]
    console.print(_table(outcomes))
    if report is not None:
        report.write_text(json.dumps([_as_dict(o) for o in outcomes], indent=2) + '\n')
    if any(outcome.fit is None for outcome in outcomes):
        sys.exit(1)


def find_bags(path: Path) -> list[Path]:
    """Return a bag itself, or the bags in a folder in the order of their names."""
    if (path / 'metadata.yaml').exists() or path.is_file():
        return [path]
    return sorted(found.parent for found in path.glob('*/metadata.yaml'))


def align_bag(bag: Path, options: Options, timing: SensorTiming | None = None) -> Outcome:
    """Align one bag, with what is known of its sensor; a refusal is an outcome too."""
    from mixtac_bringup.align.bag_recording import read_recording
    from mixtac_bringup.align.fit_file import write_fit

    began = time.perf_counter()
    try:
        edges_only = options.method == 'edges'
        recording = read_recording(bag, options.reference, options.namespace, edges_only=edges_only)
        known = (None, None) if timing is None else (timing.settings, timing.lag)
        fit, _ = recording.fit(*known, method=options.method)
        write_fit(fit, bag)
        took = time.perf_counter() - began
        if options.rewritten is not None:
            from mixtac_bringup.align.rewrite import rewrite

            options.rewritten.mkdir(parents=True, exist_ok=True)
            rewrite(bag, fit, options.rewritten / bag.name, options.reference, options.namespace)
        if options.figures is not None and not edges_only:
            from mixtac_bringup.align.figure import draw_alignment

            options.figures.mkdir(parents=True, exist_ok=True)
            draw_alignment(options.figures / f'{bag.name}.png', recording, fit, bag.name)
    except MixtacError as error:
        return Outcome(bag.name, None, str(error), time.perf_counter() - began)
    return Outcome(bag.name, fit, '', took)


def _as_dict(outcome: Outcome) -> dict[str, object]:
    from mixtac_alignment.fit_message import to_fields

    fields = {} if outcome.fit is None else to_fields(outcome.fit)
    return {'bag': outcome.bag, 'refused': outcome.reason, 'seconds': outcome.seconds, **fields}


def _table(outcomes: list[Outcome]) -> Table:
    from rich.table import Table

    table = Table(
        'bag', 'method', r'drift \[ppm]', r'+- in the middle \[ms]', r'baseline \[s]', 's'
    )
    for outcome in outcomes:
        fit = outcome.fit
        if fit is None:
            table.add_row(outcome.bag, 'refused', outcome.reason, '', '', f'{outcome.seconds:.2f}')
            continue
        first, last = fit.anchors[0].camera_us, fit.anchors[-1].camera_us
        table.add_row(
            outcome.bag,
            fit.method,
            f'{fit.drift_ppm:+.1f} +- {1e6 * float(fit.covariance[0, 0]) ** 0.5:.1f}',
            f'{1e3 * float(fit.std_at((first + last) // 2)):.2f}',
            f'{(last - first) * 1e-6:.1f}',
            f'{outcome.seconds:.2f}',
        )
    return table
