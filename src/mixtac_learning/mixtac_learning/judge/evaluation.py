# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Judging a model on bags or on simulated sensors: the work of `mixtac evaluate`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import track

from mixtac_fger.weights import Model, read_model
from mixtac_learning.judge.estimators import (
    Judged,
    TrialEstimator,
    judge_sources,
    sensor_scales,
    trial_estimator,
)
from mixtac_learning.judge.report import (
    by_profile,
    check_series,
    draw_trials,
    show_figures,
    show_skipped,
    write_series,
)
from mixtac_learning.trials.bags import BagSource, bag_sources
from mixtac_learning.trials.simulated import SimulatedSource
from mixtac_learning.trials.trial import DatasetError, TrialSource
from mixtac_node.files import write_json
from mixtac_node.topics import REFERENCE
from mixtac_recordings.bag import distinct_names
from mixtac_sim.world.training_trials import (
    TRAINING_PRESET,
    TrialSpec,
    calibration_plan,
    evaluation_plan,
    unseen_devices,
)


def run_evaluation(
    path: Path,
    bags: Sequence[Path],
    *,
    reference: str = REFERENCE,
    gels: int = 3,
    seconds: float = 10.0,
    seed: int = 2,
    preset: str = TRAINING_PRESET,
    figures: Path | None = None,
    json: Path | None = None,
    series: Path | None = None,
) -> None:
    """Judge a model on bags against the force that is known of each, or on simulated sensors.

    A bag that is named itself is always judged. Of a folder of bags that `dataset.yaml` describes
    only the test split is. The simulated sensors are ones that no training has used.

    Args:
        path: Weight file.
        bags: Bags, or folders of bags; empty for simulated sensors.
        reference: Topic of the reference force in bags.
        gels: Number of simulated sensors.
        seconds: Length of a simulated trial.
        seed: Random seed for the simulated sensors and trials.
        preset: How difficult the simulated trials are.
        figures: Picture to draw; None for none.
        json: File for the figures; None for none.
        series: File for the forces over time, .csv or .npz; None for none.

    Raises:
        ModelError: The weight file cannot be used.
        DatasetError: No trial can be judged.
        FileError: A file cannot be written.
    """
    if series is not None:
        check_series(series)
    model = read_model(path)
    estimator = trial_estimator(model)
    content: dict[str, Any] = {'model': str(path)}
    sources: Sequence[TrialSource]
    if bags:
        found = [(source, each) for each in bags for source in bag_sources(each, reference)]
        names = distinct_names(source.path for source, _ in found)
        chosen_bags = [
            replace(source, incomplete=True, shown=names[source.path])
            for source, named in found
            if source.path.resolve() == named.resolve()
            or source.origin.get('split', 'test') == 'test'
        ]
        if not chosen_bags:
            raise DatasetError(
                f'all {len(found)} bags are of the train split', remedy='name a bag itself'
            )
        _warn_of_trained(model, chosen_bags)
        sources = chosen_bags
        judged = judge_sources(estimator, track(sources, 'judging', transient=True))
        for source in chosen_bags:
            if source.name not in judged.skipped and (damage := source.damage()):
                print(f'warning: {source.name}: {damage}', file=sys.stderr)
        rows = by_profile(judged.estimates)
        title = f'{path.name} on {len(judged.estimates)} bags'
        content |= {'bags': [source.name for source in sources], 'metrics': {'bags': rows}}
    else:
        devices = unseen_devices(gels, seed)
        judged, rows = judge_devices(estimator, devices, seconds, seed, preset)
        plan = evaluation_plan(devices, seconds, seed, preset=preset)
        sources = [SimulatedSource(spec) for spec in plan if spec.profile == 'dynamic']
        title = f'{path.name} on {gels} unseen sensors, simulated'
        chosen = {'gels': gels, 'seconds': seconds, 'seed': seed, 'preset': preset}
        content |= {'simulated': chosen, 'metrics': {'unseen_devices': rows}}
    content['skipped'] = judged.skipped
    console = Console(markup=False)
    show_figures(console, title, rows)
    show_skipped(console, judged.skipped)
    if figures is not None:
        draw_trials(figures, title, judged.estimates)
        console.print(f'drawn: {figures}')
    if series is not None:
        write_series(series, judged.estimates)
        console.print(f'written: {series}')
    write_json(json, content)


def _warn_of_trained(model: Model, bags: Sequence[BagSource]) -> None:
    training = model.card.training
    trained = [bag.name for bag in bags if bag.path.name in training.get('bags', ())]
    if trained:
        names = ', '.join(trained)
        print(f'warning: the model was trained on bags of these names: {names}', file=sys.stderr)


def judge_devices(
    estimator: TrialEstimator, devices: Sequence[int], seconds: float, seed: int, preset: str
) -> tuple[Judged, dict[str, dict[str, Any]]]:
    """Judge a model on simulated sensors, raw and with one gain per sensor from one press.

    Args:
        estimator: The model.
        devices: Seeds of the sensors.
        seconds: Length of a trial.
        seed: Random seed for the trials.
        preset: How difficult the trials are.

    Returns:
        The estimates, and figures by profile.
    """

    def sources(specs: Sequence[TrialSpec], title: str) -> Any:  # noqa: ANN401 - rich's own type
        return track([SimulatedSource(spec) for spec in specs], title, transient=True)

    chosen = list(devices)
    presses = sources(calibration_plan(chosen, seconds, seed, preset), 'calibrating')
    scales = sensor_scales(estimator, presses)
    trials = sources(evaluation_plan(chosen, seconds, seed, preset=preset), 'judging')
    judged = judge_sources(estimator, trials)
    return judged, by_profile(judged.estimates, scales)
