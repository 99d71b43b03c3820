# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac simulate`: simulated trials as bags, or the first one as a picture.

The picture shows frames, their changes and events at some moments, force curves and event rates.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

import numpy as np
import typer
from matplotlib.axes import Axes
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from mixtac_cli.figures import EVENTS, REFERENCE, new_figure, save_figure
from mixtac_cli.options import OptionalPath, Preset
from mixtac_recordings.dataset import DatasetDescription, TrialSpec
from mixtac_recordings.recording import RecordingError
from mixtac_sim.bags.generation import generate
from mixtac_sim.world.datasets import DATASETS, describe, plan_dataset, plan_profile
from mixtac_sim.world.effects import preset as find_preset
from mixtac_sim.world.trial import Trial, simulate_trial

SMOOTHING_MS: Final = 20
APART_S: Final = 0.15
CONTACT_N: Final = 0.02
EDGE_S: Final = 1.1
"""The synchronising impulses take this long at the start and at the end of a trial."""
WINDOW_US: Final = 30_000
"""Length of the shown events around a moment [us]."""
RATE_BIN_US: Final = 10_000
ON_COLOUR, OFF_COLOUR, TRUE_FORCE, DENT = '#d1495b', '#2e6fbb', '#1b1b1b', '#5a9367'


def simulate(
    profile: Annotated[
        str, typer.Option(help='Force profile: idle, press, dynamic, impact, vibration, ...')
    ] = '',
    dataset: Annotated[
        str,
        typer.Option(
            help='Named data set instead: static, long_term, dynamic, impact, vibration, new_gel.'
        ),
    ] = '',
    trials: Annotated[int, typer.Option(min=1, help='Number of trials of the profile.')] = 10,
    seconds: Annotated[float, typer.Option(min=3, max=3600, help='Length of each trial (s).')] = 25,
    seed: Annotated[int, typer.Option(min=0, help='Random seed for sensors and trials.')] = 0,
    preset: Preset = 'paper_like',
    out: Annotated[
        OptionalPath, typer.Option(help='Folder of the bags; an interrupted run resumes there.')
    ] = None,
    jobs: Annotated[int, typer.Option(min=0, help='Processes; 0 for one per core.')] = 0,
    compress: Annotated[
        bool, typer.Option(help='Compress the bags (zstd): half the size, slightly slower.')
    ] = False,
    preview: Annotated[
        OptionalPath, typer.Option(help='Draw the first trial to this picture.')
    ] = None,
) -> None:
    """Simulate trials: to rosbag2 bags with the live topics and the truth, or to a picture."""
    if bool(profile) == bool(dataset):
        raise typer.BadParameter('give one of --profile and --dataset')
    if out is None and preview is None:
        raise typer.BadParameter('give --out FOLDER, --preview PICTURE or both')
    plan = _description(profile, dataset, trials, seconds, seed, preset)
    console = Console(markup=False)
    if preview is not None:
        draw_preview(plan.trials[0], preview)
        console.print(f'first trial drawn: {preview}')
    if out is not None:
        _generate(console, plan, out, jobs or os.cpu_count() or 1, compress)


def _description(
    profile: str, dataset: str, trials: int, seconds: float, seed: int, preset: str
) -> DatasetDescription:
    find_preset(preset)
    if dataset:
        planned = plan_dataset(dataset, seed, preset)
        split_by = DATASETS[dataset].split_by
    else:
        planned, split_by = plan_profile(profile, trials, seconds, seed, preset), 'trial'
    return describe(dataset or profile, seed, preset, split_by, planned)


def _generate(
    console: Console,
    plan: DatasetDescription,
    out: Path,
    jobs: int,
    compress: bool,
) -> None:
    columns = (TextColumn('{task.description}'), BarColumn(), MofNCompleteColumn())
    with Progress(*columns, TimeElapsedColumn(), console=console) as progress:
        task = progress.add_task(f'{plan.name}, {plan.preset}', total=len(plan.trials))
        try:
            written = generate(
                plan,
                out,
                jobs=jobs,
                compress=compress,
                on_progress=lambda done, total: progress.update(task, completed=done, total=total),
            )
        except OSError as error:
            raise RecordingError(f'{out} cannot be written ({error}): choose another') from error
    train, test = (len(plan.split(name)) for name in ('train', 'test'))
    console.print(
        f'{written} bags written, {len(plan.trials)} in {out}: {train} train, {test} test'
    )


@dataclass(frozen=True, slots=True)
class Moment:
    """A moment of a trial.

    Attributes:
        name: What happens then.
        t_us: Its time [us, true time].
    """

    name: str
    t_us: int


def find_moments(t_us: NDArray[np.int64], force_n: NDArray[np.float64]) -> list[Moment]:
    """Return rest, fastest rise, largest force, fastest fall and the typical force, in order.

    Moments close to an earlier one of this list are left out.

    Args:
        t_us: True time [n] [us], 1 kHz.
        force_n: True normal force [n] [N].
    """
    smooth = np.convolve(force_n, np.full(SMOOTHING_MS, 1.0 / SMOOTHING_MS), 'same')
    slope = np.gradient(smooth)
    inside = (t_us > t_us[0] + 1e6 * EDGE_S) & (t_us < t_us[-1] - 1e6 * EDGE_S)
    if not inside.any():
        inside[:] = True
    touching = smooth[inside & (smooth > CONTACT_N)]
    typical = float(np.median(touching)) if len(touching) else 0.0
    resting = np.flatnonzero(smooth < 1e-3)
    candidates = [
        ('no contact', int(resting[len(resting) // 8]) if len(resting) else 0),
        ('largest force', _highest(force_n, inside)),
        ('force rises', _highest(slope, inside)),
        ('force falls', _highest(-slope, inside)),
        ('typical force', _highest(-np.abs(smooth - typical) - 100.0 * np.abs(slope), inside)),
    ]
    found: list[Moment] = []
    for name, index in candidates:
        when = int(t_us[index])
        if all(abs(when - other.t_us) > 1e6 * APART_S for other in found):
            found.append(Moment(name, when))
    return sorted(found, key=lambda moment: moment.t_us)


def _highest(values: NDArray[np.float64], inside: NDArray[np.bool_]) -> int:
    return int(np.argmax(np.where(inside, values, -np.inf)))


def draw_preview(spec: TrialSpec, path: Path) -> None:
    """Simulate a trial and draw it.

    Args:
        spec: The trial.
        path: File to write; its suffix gives the format.

    Raises:
        SimulationError: The trial cannot be simulated.
        FileError: The picture cannot be written.
    """
    trial = simulate_trial(
        spec.device_seed,
        spec.trial_seed,
        spec.profile,
        spec.seconds,
        sync=True,
        preset=find_preset(spec.preset),
    )
    title = (
        f'Simulated trial: {spec.profile}, {spec.preset}, {spec.seconds:g} s, '
        f'sensor {spec.device_seed}, day {spec.trial_seed}'
    )
    draw_trial(trial, title, path)


def draw_trial(trial: Trial, title: str, path: Path) -> None:
    """Draw a trial.

    Args:
        trial: The trial.
        title: Title; says that the data are simulated.
        path: File to write; its suffix gives the format.
    """
    truth_us, force = trial.truth['t_us'].astype(np.int64), trial.truth['fz'].astype(np.float64)
    moments = find_moments(truth_us, force)
    figure = new_figure(14, 11.5, title)
    grid = figure.add_gridspec(5, len(moments), height_ratios=[1, 1, 1, 1.05, 0.75])
    _draw_moments(
        [
            [figure.add_subplot(grid[row, column]) for column in range(len(moments))]
            for row in range(3)
        ],
        trial,
        moments,
    )
    curves = figure.add_subplot(grid[3, :])
    _draw_forces(curves, trial, moments)
    _draw_rates(figure.add_subplot(grid[4, :], sharex=curves), trial, moments)
    save_figure(figure, path)


def _draw_moments(axes: list[list[Axes]], trial: Trial, moments: list[Moment]) -> None:
    middle = (trial.exposure_start_us + trial.exposure_end_us) // 2
    nearest = [int(np.abs(middle - moment.t_us).argmin()) for moment in moments]
    names = [moment.name for moment in moments]
    rest = nearest[names.index('no contact')] if 'no contact' in names else 0
    white = float(np.percentile(trial.frames[rest], 99.7))
    still = trial.frames[rest].astype(np.float64)
    for column, (moment, frame) in enumerate(zip(moments, nearest, strict=True)):
        image = trial.frames[frame]
        axes[0][column].imshow(image, cmap='gray', vmin=0, vmax=white)
        change = image - still
        axes[1][column].imshow(change, cmap='RdBu_r', vmin=-0.5 * white, vmax=0.5 * white)
        picture, count = event_picture(trial, moment.t_us)
        axes[2][column].imshow(picture)
        force = np.interp(moment.t_us, trial.truth['t_us'], trial.truth['fz'])
        axes[0][column].set_title(
            f'{moment.name}\n{1e-6 * moment.t_us:.2f} s, {force:.2f} N', fontsize=10
        )
        axes[2][column].set_xlabel(f'{count} events', fontsize=9)
        for row in range(3):
            axes[row][column].set(xticks=[], yticks=[])
    axes[0][0].set_ylabel('frame')
    axes[1][0].set_ylabel('frame minus frame at rest')
    axes[2][0].set_ylabel(f'events of {WINDOW_US // 1000} ms\n(ON red, OFF blue)')


def event_picture(trial: Trial, centre_us: int) -> tuple[NDArray[np.float64], int]:
    """Return the events around a moment as a picture [height, width, 3] and their number.

    The more events of a polarity a pixel had, the stronger its colour.
    """
    edges = (centre_us - WINDOW_US // 2, centre_us + WINDOW_US // 2)
    first, last = np.searchsorted(trial.events.t, edges)
    events = trial.events[int(first) : int(last)]
    shape = trial.frames.shape[1:]
    picture = np.ones((*shape, 3))
    for polarity, colour in ((True, ON_COLOUR), (False, OFF_COLOUR)):
        counts = np.zeros(shape)
        chosen = events.polarity == polarity
        np.add.at(counts, (events.y[chosen], events.x[chosen]), 1.0)
        # Single pixels would be lost when the picture is scaled down.
        counts[1:, 1:] = np.maximum(counts[1:, 1:], 0.6 * counts[:-1, :-1])
        strength = 1.0 - 0.2**counts
        tint = np.array([int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)])
        picture *= 1.0 - strength[:, :, None] * (1.0 - tint)
    return picture, int(last - first)


def _draw_forces(axes: Axes, trial: Trial, moments: list[Moment]) -> None:
    a, b = trial.clock
    reference_s = 1e-6 * (trial.reference_t_us - b) / a
    axes.plot(
        reference_s,
        trial.reference_wrench[:, 2],
        color=REFERENCE,
        lw=1.0,
        label='reference sensor (true clock map)',
    )
    axes.plot(1e-6 * trial.truth['t_us'], trial.truth['fz'], color=TRUE_FORCE, lw=0.9, label='true')
    depth = axes.twinx()
    depth.plot(
        1e-6 * trial.truth['t_us'], trial.truth['depth_mm'], color=DENT, lw=0.8, label='dent'
    )
    depth.set_ylabel('dent [mm]', color=DENT)
    depth.set_ylim(bottom=0.0)
    axes.set(ylabel='normal force [N]', xlim=(0.0, trial.profile.duration_s))
    axes.margins(y=0.18)
    _finish(axes, trial, moments)


def _draw_rates(axes: Axes, trial: Trial, moments: list[Moment]) -> None:
    edges = np.arange(0, round(1e6 * trial.profile.duration_s) + RATE_BIN_US, RATE_BIN_US)
    times = 1e-6 * (edges[:-1] + RATE_BIN_US // 2)
    for polarity, colour, label in ((True, ON_COLOUR, 'ON'), (False, OFF_COLOUR, 'OFF')):
        counts, _ = np.histogram(trial.events.t[trial.events.polarity == polarity], edges)
        axes.semilogy(
            times, np.maximum(counts, 1) * 1e6 / RATE_BIN_US, color=colour, lw=0.8, label=label
        )
    axes.set(xlabel='time [s]', ylabel='events [1/s]')
    _finish(axes, trial, moments)


def _finish(axes: Axes, trial: Trial, moments: list[Moment]) -> None:
    """Add grid, legend, moments and synchronising impulses."""
    axes.grid(visible=True, alpha=0.25)
    axes.legend(loc='upper left', ncols=2, frameon=False, fontsize=9)
    for moment in moments:
        axes.axvline(1e-6 * moment.t_us, color=EVENTS, lw=1.0, ls='--', zorder=0)
    for centre_s in trial.profile.sync_s:
        axes.axvspan(centre_s - 0.05, centre_s + 0.05, color='#cfe8cf', zorder=0)
