# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What `mixtac evaluate` does: judge a model on bags or on simulated trials."""

from __future__ import annotations

import json as json_module
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import track

from mixtac_learning.judge.estimators import judge_sources, load_estimator, sensor_scales
from mixtac_learning.judge.report import by_profile, draw_trials, show_figures, show_skipped
from mixtac_learning.trials.bags import bag_sources
from mixtac_learning.trials.simulated import SimulatedSource
from mixtac_sim.world.training_trials import calibration_plan, evaluation_plan, unseen_devices

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from mixtac_learning.judge.estimators import Judged
    from mixtac_learning.trials.trial import TrialSource


@dataclass(frozen=True, slots=True)
class Simulated:
    """Simulated trials to judge by.

    Attributes:
        gels: Number of sensors.
        seconds: Length of a trial.
        seed: Which sensors and days.
        preset: How hard.
    """

    gels: int
    seconds: float
    seed: int
    preset: str


@dataclass(frozen=True, slots=True)
class Wanted:
    """What an evaluation gives out beside its table.

    Attributes:
        figures: Picture to draw; None for none.
        json: File for the figures; None for none.
        robustness: Judge with lost frames and packets as well.
    """

    figures: Path | None = None
    json: Path | None = None
    robustness: bool = False


def evaluate_bags(model: Path, bags: Sequence[Path], reference: str, wanted: Wanted) -> None:
    """Judge a model on bags against the force that is known of each.

    Of bags that `dataset.yaml` describes only the test split is used.

    Args:
        model: Weight file.
        bags: Bags, or folders of bags.
        reference: Topic of the reference force.
        wanted: What to give out.

    Raises:
        ModelError: The weight file cannot be used.
        DatasetError: No bag can be judged.
    """
    estimator = load_estimator(model)
    found = [source for folder in bags for source in bag_sources(folder, reference)]
    sources = [source for source in found if source.origin.get('split', 'test') == 'test']
    judged = judge_sources(estimator, track(sources, 'judging', transient=True))
    rows = by_profile(judged.estimates)
    _report(f'{model.name} on {len(judged.estimates)} bags', rows, judged, wanted.figures)
    content: dict[str, Any] = {'model': str(model), 'bags': [source.name for source in sources]}
    content |= {'metrics': {'bags': rows}, 'skipped': judged.skipped}
    _write(wanted.json, content | _robustness(model, sources, wanted))


def evaluate_simulated(model: Path, chosen: Simulated, wanted: Wanted) -> None:
    """Judge a model on simulated sensors that no training has used.

    Args:
        model: Weight file.
        chosen: Which trials.
        wanted: What to give out.

    Raises:
        ModelError: The weight file cannot be used.
    """
    estimator = load_estimator(model)
    devices = unseen_devices(chosen.gels, chosen.seed)
    days = (chosen.seconds, chosen.seed)
    presses = [SimulatedSource(s) for s in calibration_plan(devices, *days, chosen.preset)]
    scales = sensor_scales(estimator, track(presses, 'calibrating', transient=True))
    plan = evaluation_plan(devices, *days, preset=chosen.preset)
    trials = [SimulatedSource(spec) for spec in plan]
    judged = judge_sources(estimator, track(trials, 'judging', transient=True))
    rows = by_profile(judged.estimates, scales)
    _report(
        f'{model.name} on {chosen.gels} unseen sensors, simulated', rows, judged, wanted.figures
    )
    content: dict[str, Any] = {'model': str(model), 'simulated': asdict(chosen)}
    content |= {'metrics': {'unseen_devices': rows}, 'skipped': judged.skipped}
    dynamic = [each for each in trials if each.origin['profile'] == 'dynamic']
    _write(wanted.json, content | _robustness(model, dynamic, wanted))


def _report(title: str, rows: dict[str, Any], judged: Judged, figures: Path | None) -> None:
    console = Console()
    show_figures(console, title, rows)
    show_skipped(console, judged.skipped)
    if figures is not None:
        draw_trials(figures, title, judged.estimates)
        console.print(f'drawn: {figures}')


def _robustness(model: Path, sources: Sequence[TrialSource], wanted: Wanted) -> dict[str, Any]:
    """Return the figures with losses, where they are wanted, and show them."""
    if not wanted.robustness:
        return {}
    from mixtac_fger.weights import load_model
    from mixtac_learning.judge.robustness import robustness

    rows = robustness(load_model(model), track(sources, 'losing', transient=True))
    console = Console()
    for kind, row in rows.items():
        figures = ', '.join(f'{name.replace("_", " ")} {value}' for name, value in row.items())
        console.print(f'{kind.replace("_", " ")}: {figures}', highlight=False)
    return {'robustness': rows}


def _write(path: Path | None, content: dict[str, Any]) -> None:
    if path is not None:
        path.write_text(json_module.dumps(content, indent=2) + '\n', encoding='utf-8')
