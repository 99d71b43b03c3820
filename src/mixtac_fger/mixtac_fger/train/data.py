# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The trials of a run, and which of them are held out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from mixtac_fger.trial_plan import TRAINING_PROFILES, training_plan
from mixtac_fger.trials.bag_source import bag_sources
from mixtac_fger.trials.preparation import prepare
from mixtac_fger.trials.simulated_source import SimulatedSource

if TYPE_CHECKING:
    from collections.abc import Callable

    from mixtac_fger.train.run_config import DataConfig
    from mixtac_fger.trials.preparation import Recipe
    from mixtac_fger.trials.trial_source import TrialSource


@dataclass(frozen=True, slots=True)
class TrainingData:
    """Samples of a run.

    Attributes:
        trained: Files to train on.
        checked: Files to validate on.
        sources: Where the samples to train on came from.
        skipped: Why a trial was left out, by its name.
    """

    trained: list[Path]
    checked: list[Path]
    sources: list[TrialSource]
    skipped: dict[str, str]


def training_sources(data: DataConfig) -> list[TrialSource]:
    """Return the trials that a run may train on.

    Raises:
        DatasetError: A folder holds no bags.
    """
    found: list[TrialSource] = []
    if data.simulated is not None:
        wanted = data.simulated
        plan = training_plan(
            wanted.trials,
            min(wanted.sensors, wanted.trials),
            wanted.seconds,
            wanted.seed,
            wanted.preset,
            wanted.profiles or TRAINING_PROFILES,
        )
        found += [SimulatedSource(spec) for spec in plan]
    for folder in data.bags:
        bags = bag_sources(Path(folder).expanduser(), data.reference)
        found += [bag for bag in bags if bag.origin.get('split', 'train') == 'train']
    return found


def gather(
    data: DataConfig,
    recipe: Recipe,
    jobs: int = 1,
    on_progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> TrainingData:
    """Prepare the samples of a run; every n-th trial is held out, never a part of one.

    Args:
        data: What to train on.
        recipe: How the network wants its samples.
        jobs: Processes.
        on_progress: Called with the number of trials done and of all.

    Raises:
        DatasetError: No trial can be used.
    """
    sources = training_sources(data)
    total = len(sources)
    folder = Path(data.cache)
    prepared = prepare(sources, recipe, folder, jobs, lambda done: on_progress(done, total))
    every = round(1.0 / data.checked) if data.checked > 0.0 else 0
    pairs = list(zip(prepared.paths, prepared.kept, strict=True))
    held = [i for i in range(len(pairs)) if every and len(pairs) > 1 and i % every == every - 1]
    trained = [pair for index, pair in enumerate(pairs) if index not in held]
    return TrainingData(
        [path for path, _ in trained],
        [pairs[index][0] for index in held],
        [sources[index] for _, index in trained],
        prepared.skipped,
    )
