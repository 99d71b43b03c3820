# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac align`: fit the clock of the reference force in recordings, and draw the result."""

from __future__ import annotations

import json
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Optional, cast

import numpy as np
import typer

from mixtac_events.errors import MixtacError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from rich.table import Table

    from mixtac_alignment.clock_fit import ClockFit
    from mixtac_alignment.pool import SensorTiming
    from mixtac_alignment.recording import Method, Recording


EVENTS, FORCE, ANCHOR = '#5a5a5a', '#1f4e8c', '#c0392b'
CLOSE_S = 0.08


def draw_alignment(path: Path, recording: Recording, fit: ClockFit, title: str) -> None:
    """Save the figure of an alignment.

    Args:
        path: File to write; its suffix gives the format.
        recording: What was aligned.
        fit: The clock map.
        title: Title.
    """
    import matplotlib as mpl

    mpl.use('Agg')
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(3, 2, figsize=(11.0, 8.5), layout='constrained')
    figure.suptitle(f'{title}: {fit.method}, {fit.summary()}', fontsize=9)
    for axis in axes.flat:
        axis.spines[['top', 'right']].set_visible(False)
    _whole(axes[0, 0], recording, fit, aligned=False)
    _whole(axes[0, 1], recording, fit, aligned=True)
    _close(axes[1, 0], recording, fit, 0)
    _close(axes[1, 1], recording, fit, -1)
    _residuals(axes[2, 0], fit)
    _uncertainty(axes[2, 1], recording, fit)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def _streams(
    axis: Axes,
    recording: Recording,
    fit: ClockFit,
    start_s: float,
    end_s: float,
    *,
    aligned: bool,
) -> None:
    """Draw event rate and force from start to end, in seconds since the first event."""
    counts = recording.counts
    t = (np.arange(len(counts.counts)) + 0.5) * counts.width_us * 1e-6
    shown = (t >= start_s) & (t <= end_s)
    axis.plot(t[shown], counts.counts[shown] / counts.width_us, color=EVENTS, lw=0.6)
    axis.set_ylabel('event rate [Mev/s]', color=EVENTS)
    if aligned:
        force_t = (fit.to_camera(recording.force_t_s) - counts.start_us) * 1e-6
    else:
        force_t = recording.force_t_s - counts.start_us * 1e-6
        if abs(force_t[0]) > 60.0:
            force_t = recording.force_t_s - recording.force_t_s[0]
    shown = (force_t >= start_s) & (force_t <= end_s)
    force = axis.twinx()
    force.spines['top'].set_visible(False)
    force.plot(force_t[shown], recording.force[shown], color=FORCE, lw=0.9)
    force.set_ylabel('force [N]', color=FORCE)


def _whole(axis: Axes, recording: Recording, fit: ClockFit, *, aligned: bool) -> None:
    end_s = len(recording.counts.counts) * recording.counts.width_us * 1e-6
    _streams(axis, recording, fit, -5.0, end_s + 5.0, aligned=aligned)
    axis.set_title(
        'after: both on the camera clock' if aligned else 'before: each on its own clock'
    )
    axis.set_xlabel('time since the first event [s]')
    if aligned:
        _anchors(axis, recording, fit)


def _close(axis: Axes, recording: Recording, fit: ClockFit, which: int) -> None:
    at_s = (fit.anchors[which].camera_us - recording.counts.start_us) * 1e-6
    _streams(axis, recording, fit, at_s - CLOSE_S, at_s + CLOSE_S, aligned=True)
    _anchors(axis, recording, fit)
    axis.set_xlim(at_s - CLOSE_S, at_s + CLOSE_S)
    axis.set_title('first anchor' if which == 0 else 'last anchor')
    axis.set_xlabel('time since the first event [s]')


def _anchors(axis: Axes, recording: Recording, fit: ClockFit) -> None:
    for anchor in fit.anchors:
        at_s = (anchor.camera_us - recording.counts.start_us) * 1e-6
        axis.axvline(at_s, color=ANCHOR, lw=0.8, ls='--')


def _residuals(axis: Axes, fit: ClockFit) -> None:
    first = fit.anchors[0].camera_us
    t = [(anchor.camera_us - first) * 1e-6 for anchor in fit.anchors]
    std = [1e3 * anchor.std_s for anchor in fit.anchors]
    axis.errorbar(t, 1e3 * fit.residuals_s, yerr=std, fmt='o', color=ANCHOR, capsize=3)
    axis.axhline(0.0, color=EVENTS, lw=0.6)
    axis.set_title('anchors less the map, with their standard deviation')
    axis.set_xlabel('time since the first anchor [s]')
    axis.set_ylabel('residual [ms]')


def _uncertainty(axis: Axes, recording: Recording, fit: ClockFit) -> None:
    counts = recording.counts
    t_s = np.linspace(0.0, len(counts.counts) * counts.width_us * 1e-6, 100)
    half = 1.96e3 * fit.std_at(counts.start_us + np.rint(t_s * 1e6).astype(np.int64))
    axis.fill_between(t_s, -half, half, color=FORCE, alpha=0.25, lw=0)
    axis.set_title('95 % interval of the map')
    axis.set_xlabel('time since the first event [s]')
    axis.set_ylabel('time error [ms]')


METHODS: Final = ('refined', 'two_impulse', 'paper', 'edges')
OptionalPath = Optional[Path]  # noqa: UP045  (typer evaluates this under Python 3.10)


@dataclass(frozen=True, slots=True)
class AlignOptions:
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
class BagOutcome:
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
    options = AlignOptions(reference, namespace, cast('Method', method), pool, rewrite, figure)
    found = [bag for path in bags for bag in find_bags(path)]
    if not found:
        raise typer.BadParameter(f'no bag in {", ".join(map(str, bags))}')
    quiet = len(found) < 2
    timings = {}
    if pool and not quiet and method in ('refined', 'two_impulse'):
        from mixtac_alignment.pool import sensor_timings

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


def align_bag(bag: Path, options: AlignOptions, timing: SensorTiming | None = None) -> BagOutcome:
    """Align one bag, with what is known of its sensor; a refusal is an outcome too."""
    from mixtac_alignment.fit_files import write_fit
    from mixtac_alignment.recording import read_recording

    began = time.perf_counter()
    try:
        edges_only = options.method == 'edges'
        recording = read_recording(bag, options.reference, options.namespace, edges_only=edges_only)
        known = (None, None) if timing is None else (timing.settings, timing.lag)
        fit, _ = recording.fit(*known, method=options.method)
        write_fit(fit, bag)
        took = time.perf_counter() - began
        if options.rewritten is not None:
            from mixtac_alignment.fit_files import rewrite_bag

            options.rewritten.mkdir(parents=True, exist_ok=True)
            rewrite_bag(
                bag, fit, options.rewritten / bag.name, options.reference, options.namespace
            )
        if options.figures is not None and not edges_only:
            options.figures.mkdir(parents=True, exist_ok=True)
            draw_alignment(options.figures / f'{bag.name}.png', recording, fit, bag.name)
    except MixtacError as error:
        return BagOutcome(bag.name, None, str(error), time.perf_counter() - began)
    return BagOutcome(bag.name, fit, '', took)


def _as_dict(outcome: BagOutcome) -> dict[str, object]:
    from mixtac_alignment.clock_fit import to_fields

    fields = {} if outcome.fit is None else to_fields(outcome.fit)
    return {'bag': outcome.bag, 'refused': outcome.reason, 'seconds': outcome.seconds, **fields}


def _table(outcomes: list[BagOutcome]) -> Table:
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
