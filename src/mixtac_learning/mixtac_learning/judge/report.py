# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Figures of a model over trials: computed, as tables on the terminal, as plots, as series."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track

from mixtac.figures import make_table, new_axes, save_figure
from mixtac_core.node.files import replacing
from mixtac_core.node.topics import REFERENCE
from mixtac_core.recordings.bag import distinct_names
from mixtac_fger.validity import Reason
from mixtac_fger.weights import Model
from mixtac_learning.judge.estimators import (
    TrialEstimate,
    TrialEstimator,
    judge_sources,
    trial_estimator,
)
from mixtac_learning.judge.metrics import by_profile, fit_scale, trial_row
from mixtac_learning.trials.bags import BagSource, bag_sources
from mixtac_learning.trials.trial import DatasetError, SimulatedSource
from mixtac_sim.world.plans import TrialSpec, evaluation_plan

COLUMNS = (
    *('mae', 'rmse', 'r2', 'calibrated_mae', 'sideways_mae', 'torque_mae_nmm', 'peak_error'),
    *('coverage_68', 'coverage_95'),
)
"""Figures that are shown, in this order; those that no row has are left out."""


def show_figures(title: str, figures: Mapping[str, Mapping[str, Any]]) -> None:
    """Print the figures of `COLUMNS`, one row per profile."""
    names = [name for name in COLUMNS if any(name in row for row in figures.values())]
    rows = [
        (profile, *(f'{row[name]:.3f}' if name in row else '-' for name in names))
        for profile, row in figures.items()
    ]
    headings = ['profile', *(name.replace('_', ' ') for name in names)]
    Console().print(make_table(title, headings, rows))


def show_skipped(skipped: Mapping[str, str]) -> None:
    """Print which trials were left out and why."""
    for name, reason in skipped.items():
        print(f'left out {name}: {reason}')


MOST_ROWS = 4
"""Trials in a picture, at most."""


def draw_trials(path: Path, title: str, estimates: Sequence[TrialEstimate]) -> None:
    """Draw the force over time of the first trial of each profile.

    Args:
        path: Picture to write; its folder is made if need be.
        title: Above the picture.
        estimates: Estimates.

    Raises:
        FileError: As `save_figure`.
    """
    firsts = {each.profile: each for each in reversed(estimates)}
    chosen = list(reversed(firsts.values()))[:MOST_ROWS]
    figure, axes = new_axes(1, len(chosen), 9.0, 2.4 * len(chosen) + 0.4)
    figure.suptitle(title)
    for ax, each in zip(axes, chosen, strict=True):
        seconds = (each.t_us - each.t_us[0]) / 1e6
        ax.plot(seconds, each.known, 'k', lw=1.2, label='known force')
        if each.frames_only is not None:
            ax.plot(seconds, each.frames_only, 'tab:orange', lw=0.6, label='frames only')
        ax.plot(seconds, each.force, 'tab:green', lw=0.8, label='estimate')
        ax.set(title=f'{each.profile}: {each.name}', xlabel='time [s]', ylabel='force [N]')
        ax.legend(fontsize='x-small')
    save_figure(figure, path)


SERIES = (
    'trial,"stamp [us, camera clock]","force [N]","deviation [N]",valid,reason,"reference [N]"\n'
)
"""Headings of a series."""


def write_series(path: Path, estimates: Sequence[TrialEstimate]) -> None:
    """Write forces over time to a CSV file, a row per window.

    Columns: name of the trial; end of the window, camera clock [us]; force [N]; standard deviation
    of the force [N], NaN if the model estimates none; whether the force is valid; reason if it is
    not valid; known force [N]. A force of a model without checks counts as valid.

    Args:
        path: File.
        estimates: Estimates.

    Raises:
        FileError: It cannot be written.
    """
    with replacing(path) as scratch, scratch.open('w', encoding='utf-8') as file:
        file.write(SERIES)
        for each in estimates:
            unknown = np.full(len(each.t_us), np.nan)
            deviations = unknown if each.deviation is None else each.deviation
            reasons = np.zeros(len(each.t_us), int) if each.reasons is None else each.reasons
            columns = (each.t_us, each.force, deviations, reasons, each.known)
            rows = zip(*(column.tolist() for column in columns), strict=True)
            for stamp, force, deviation, reason, known in rows:
                trusted, name = int(reason == Reason.TRUSTED), Reason(reason).name
                file.write(
                    f'{each.name},{stamp},{force:.6f},{deviation:.6f},{trusted},{name},{known:.6f}\n'
                )


def judge_bags(
    model: Model, folders: Sequence[Path], reference: str = REFERENCE
) -> tuple[list[TrialEstimate], dict[str, Any]]:
    """Judge a model on bags against the force that is known of each.

    A bag that is named itself is always judged. Of a folder of bags that `dataset.yaml` describes
    only the test split is.

    Args:
        model: Content of a weight file.
        folders: Bags, or folders of bags.
        reference: Topic of the reference force.

    Returns:
        The estimates; and for JSON the names of the `bags`, `metrics` by profile, `rows`, and why
        bags were `skipped`.

    Raises:
        ModelError: The weights do not fit their architecture.
        DatasetError: No trial can be evaluated.
    """
    chosen = _chosen_bags(folders, reference)
    trained = model.card.training.get('bags', ())
    if known := ', '.join(bag.name for bag in chosen if bag.path.name in trained):
        warning = 'warning: the model was trained on bags of these names:'
        print(warning, known, file=sys.stderr)
    sources = track(chosen, 'judging', transient=True)
    estimates, skipped = judge_sources(trial_estimator(model), sources)
    for bag in chosen:
        if bag.name not in skipped and (damage := bag.damage()):
            print(f'warning: {bag.name}: {damage}', file=sys.stderr)
    paths = {bag.name: str(bag.path) for bag in chosen}
    return estimates, {
        'bags': list(paths),
        'metrics': {'bags': by_profile(estimates)},
        'rows': [trial_row(each) | {'bag': paths[each.name]} for each in estimates],
        'skipped': skipped,
    }


def _chosen_bags(folders: Sequence[Path], reference: str) -> list[BagSource]:
    """Return the bags that are named, and the bags of the test split in folders."""
    found = [(source, each) for each in folders for source in bag_sources(each, reference)]
    names = distinct_names(source.path for source, _ in found)
    chosen = [
        replace(source, incomplete=True, shown=names[source.path])
        for source, named in found
        if source.path.resolve() == named.resolve() or source.origin.get('split', 'test') == 'test'
    ]
    if not chosen:
        raise DatasetError(
            f'all {len(found)} bags are of the train split', remedy='name a bag itself'
        )
    return chosen


def judge_devices(
    estimator: TrialEstimator, devices: Sequence[int], seconds: float, seed: int, preset: str
) -> tuple[list[TrialEstimate], dict[str, Any]]:
    """Judge a model on simulated sensors, raw and with one gain per sensor from one press.

    Args:
        estimator: The model.
        devices: Seeds of the sensors.
        seconds: Length of a trial.
        seed: Random seed for the trials.
        preset: How difficult the trials are.

    Returns:
        The estimates; and for JSON `metrics` by profile, `rows`, and why trials were `skipped`.

    Raises:
        MixtacError: No trial can be used, or the model does not see a press.
    """

    def sources(specs: Sequence[TrialSpec], title: str) -> Any:  # noqa: ANN401 - rich's own type
        return track([SimulatedSource(spec) for spec in specs], title, transient=True)

    chosen = list(devices)
    # On a day that no other trial has.
    plan = evaluation_plan(chosen, seconds, seed, preset, ('press',), first=99)
    presses = sources(plan, 'calibrating')
    pressed = [estimator(source.load()) for source in presses]
    scales = {press.device: fit_scale(press.force, press.known) for press in pressed}
    trials = sources(evaluation_plan(chosen, seconds, seed, preset=preset), 'judging')
    estimates, skipped = judge_sources(estimator, trials)
    return estimates, {
        'metrics': {'unseen_devices': by_profile(estimates, scales)},
        'rows': [trial_row(each) for each in estimates],
        'skipped': skipped,
    }
