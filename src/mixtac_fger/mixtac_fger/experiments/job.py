# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""One model and one seed of the table: train, judge, keep the figures."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mixtac_fger import generation
from mixtac_fger.experiments.stiffness_bound import StiffnessBound
from mixtac_fger.experiments.suite import BOUND, CONSTANT, run_config, test_specs, unseen_specs
from mixtac_fger.judge.estimators import constant_estimator
from mixtac_fger.judge.judging import judge_sources, sensor_scales
from mixtac_fger.judge.summary import by_profile, summarise
from mixtac_fger.train.command import estimator_of
from mixtac_fger.train.data import training_sources
from mixtac_fger.train.run_config import OURS
from mixtac_fger.train.runner import Run, save
from mixtac_fger.trials.changed_source import ChangedSource
from mixtac_fger.trials.mismatch import MISMATCHES
from mixtac_fger.trials.simulated_source import SimulatedSource
from mixtac_fger.trials.trial_cache import CachedSource

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from mixtac_fger.experiments.suite import Suite
    from mixtac_fger.judge.trial_estimate import TrialEstimator
    from mixtac_fger.train.loop import Report
    from mixtac_fger.trial_plan import TrialSpec
    from mixtac_fger.trials.trial_source import TrialSource

UNSEEN, UNSEEN_GAIN = 'unseen_gel', 'unseen_gel_one_gain'


@dataclass(frozen=True, slots=True)
class Job:
    """One cell column of the table.

    Attributes:
        suite: Sizes.
        size: Their name.
        model: One of `mixtac_fger.experiments.suite.ROWS`.
        seed: Of the training.
        folder: Where samples, checkpoints and results are kept.
    """

    suite: Suite
    size: str
    model: str
    seed: int
    folder: Path

    @property
    def result_path(self) -> Path:
        """File of the figures; its name holds the simulator's digest: others are stale."""
        digest = generation.simulator_digest()
        return self.folder / f'{self.size}_{self.model}_s{self.seed}_{digest}.json'

    def result(self) -> dict[str, Any] | None:
        """Return the figures of an earlier run, None where there are none."""
        try:
            found: dict[str, Any] = json.loads(self.result_path.read_text(encoding='utf-8'))
        except (OSError, ValueError):
            return None
        return found

    def carry_out(self, jobs: int, report: Report, say: Callable[[str], None]) -> dict[str, Any]:
        """Train and judge; a training that was cut off goes on.

        Args:
            jobs: Processes that simulate.
            report: Called after each epoch.
            say: Called with what is done now.
        """
        config = run_config(self.suite, self.model, self.seed, str(self.folder / 'samples'))
        training: dict[str, Any] = {}
        estimator: TrialEstimator
        if self.model == CONSTANT:
            say('constant: looking at the training forces')
            estimator = constant_estimator(_median_force(training_sources(config.data)))
        elif self.model == BOUND:
            sources = training_sources(config.data)
            estimator = StiffnessBound(frozenset(s.origin['device_seed'] for s in sources))
        else:
            say(f'{self.model}, seed {self.seed}: training')
            name = f'{self.size}_{self.model}_s{self.seed}'
            trained = Run(config, self.folder / name, jobs, report).carry_out()
            save(self.folder / name / 'model.safetensors', trained, {})
            training, estimator = trained.card.training, estimator_of(trained)
        say(f'{self.model}, seed {self.seed}: judging')
        figures = judge_all(estimator, self.suite, self.folder / 'trials')
        found = {'model': self.model, 'seed': self.seed, 'size': self.size, 'figures': figures}
        found['training'] = training
        self.folder.mkdir(parents=True, exist_ok=True)
        partial = self.result_path.with_suffix('.partial')
        partial.write_text(json.dumps(found, indent=1) + '\n', encoding='utf-8')
        partial.replace(self.result_path)
        return found


def judge_all(estimator: TrialEstimator, suite: Suite, cache: Path) -> dict[str, Any]:
    """Return the figures of a model in every column of the table.

    Args:
        estimator: The model.
        suite: Sizes.
        cache: Where test trials are kept for the next model.
    """

    def cached(specs: list[TrialSpec]) -> list[TrialSource]:
        return [CachedSource(SimulatedSource(spec), cache) for spec in specs]

    config = run_config(suite, OURS, 0, '')
    device = training_sources(config.data)[0].origin['device_seed']
    seen = cached(test_specs(suite, device))
    figures = by_profile(judge_sources(estimator, seen).estimates)
    trials, presses = map(cached, unseen_specs(suite))
    unseen = judge_sources(estimator, trials).estimates
    figures[UNSEEN] = summarise(unseen)
    scales = sensor_scales(estimator, presses, fallback=1.0)
    figures[UNSEEN_GAIN] = summarise([each.scaled(scales[each.device]) for each in unseen])
    dynamic = [source for source in seen if source.origin['profile'] == 'dynamic']
    for name, change in MISMATCHES.items():
        changed = [ChangedSource(source, name, change) for source in dynamic]
        figures[name] = summarise(judge_sources(estimator, changed).estimates)
    return figures


def _median_force(sources: list[TrialSource]) -> float:
    labels = [source.load().label() for source in sources]
    return float(np.median(np.concatenate([label.force for label in labels])))
