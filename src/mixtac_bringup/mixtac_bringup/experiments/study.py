# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Models that several experiments share: trained once per seed, judged once per trial."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mixtac_bringup.experiments.estimate_files import load_estimate, save_estimate
from mixtac_bringup.experiments.pieces import stem_of, tell
from mixtac_bringup.experiments.sizes import DYNAMIC, HOLD, IMPACT, STATIC
from mixtac_bringup.experiments.sources_digest import sensor_digest
from mixtac_bringup.experiments.trial_sets import trial_sets
from mixtac_fger.train.run_config import OURS, DataConfig, RunConfig
from mixtac_fger.trials.bag_source import BagSource

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.progress import Progress, TaskID

    from mixtac_bringup.experiments.context import Context
    from mixtac_bringup.experiments.sizes import Sizes
    from mixtac_fger.judge.trial_estimate import TrialEstimate
    from mixtac_fger.trials.preparation import Recipe
    from mixtac_fger.trials.trial_source import TrialSource

FGER, FRAMES, EVENTS, FUSION = 'fger', 'frames', 'events', 'fusion'
"""The paper's networks."""
LABELS = {
    OURS: 'FGER-Net, small (ours)',
    FGER: "FGER-Net, the paper's layers",
    FRAMES: 'frames only',
    EVENTS: 'events only',
    FUSION: 'feature-level fusion',
}
"""Names of the models for people."""
MODELS = {
    DYNAMIC: (OURS, FGER, FRAMES, EVENTS),
    STATIC: (OURS, FGER, FUSION),
    HOLD: (OURS, FGER),
    IMPACT: (OURS, FGER),
}
"""Models that are judged on each profile."""
Estimates = dict[str, dict[int, list['TrialEstimate']]]
"""Estimates by model and seed."""


def deviations(sizes: Sizes) -> tuple[str, ...]:
    """Return what differs from the paper wherever models are trained."""
    scale = sizes.paper_network['scale']
    training = sizes.paper_training
    reduced = (
        f"The paper's networks see frames averaged over {scale} x {scale} pixels and at most"
        f' {sizes.paper_network["events_per_packet"]} events per packet, and are trained for'
        f' {training["epochs"]} epochs with batches of {training["batch"]} and a rate of'
        f' {training["rate"]:g} (paper: 50 epochs, 128, 1e-4): what two CPU cores do in the'
        ' time there is. `mixtac experiments models --size native` trains them as stated, on'
        ' a GPU.'
    )
    together = (
        f'One training set of all profiles for all experiments, {sizes.trials} trials of'
        f' {sizes.seconds:g} s per sensor, where the paper trains on the data set of each.'
    )
    widths = (
        'Widths and the use of frames within a cycle are not in the paper; docs/fger.md says'
        ' what was taken.'
    )
    return together, reduced, widths


def run_config(sizes: Sizes, model: str, seed: int, data: DataConfig, cache: Path) -> RunConfig:
    """Return the training run of a model."""
    ours = model == OURS
    training = sizes.our_training if ours else sizes.paper_training
    return RunConfig(
        model=model,
        network={} if ours else sizes.paper_network,
        training=training | {'seed': seed},
        data=replace(data, cache=str(cache)),
    )


@dataclass(frozen=True, slots=True)
class TrainPiece:
    """The training of one model with one seed.

    Attributes:
        model: Which.
        seed: Of weights, order and, simulated, of the sensor.
        config: The run.
    """

    model: str
    seed: int
    config: RunConfig

    @property
    def label(self) -> str:
        """Model and seed."""
        return f'model_{self.model}_s{self.seed}'

    def identity(self) -> str:
        """Return the run's fingerprint and the simulator's."""
        return f'{self.config.fingerprint()} {_data_version(self.config.data)}'

    def compute(self, folder: Path, stem: str) -> dict[str, Any]:
        """Train; a run that was cut off goes on."""
        import torch

        from mixtac_fger import generation
        from mixtac_fger.train.runner import Run, save

        torch.set_num_threads(1)
        # Samples are named after the whole simulator, and so is what was begun with them.
        begun = folder / f'{stem}_{generation.simulator_digest()}'

        def report(stage: str, epoch: int, epochs: int, _loss: float, _error: float | None) -> None:
            tell(folder, stem, f'{self.model} s{self.seed}: {stage} {epoch}/{epochs}')

        trained = Run(self.config, begun, report=report).carry_out()
        save(folder / f'{stem}.safetensors', trained, {})
        return {'minutes': trained.card.training['minutes'], 'skipped': trained.skipped}


@dataclass(frozen=True, slots=True)
class JudgePiece:
    """All models of a seed on one trial, which is loaded once.

    Attributes:
        seed: Of the models.
        source: The trial.
        weights: Stem of the weight file by model.
    """

    seed: int
    source: TrialSource
    weights: dict[str, str]

    @property
    def label(self) -> str:
        """Seed and trial."""
        return f'judged_s{self.seed}_{self.source.name}'

    def identity(self) -> str:
        """Return the models and the trial."""
        if isinstance(self.source, BagSource):
            version = _bags_version([self.source.path])
        else:
            version = f'{self.source.name} {sensor_digest()}'
        return json.dumps([self.weights, version], sort_keys=True)

    def compute(self, folder: Path, stem: str) -> dict[str, Any]:
        """Estimate the trial with each model.

        Raises:
            MixtacError: The trial cannot be used.
        """
        import torch

        from mixtac_fger.judge.estimators import load_estimator

        torch.set_num_threads(1)
        trial = self.source.load()
        files = {}
        for model, weights in self.weights.items():
            estimate = load_estimator(folder / f'{weights}.safetensors').estimate(trial)
            files[model] = f'{stem}_{model}.npz'
            save_estimate(folder / files[model], estimate)
        return {'files': files}


def estimates(context: Context, profile: str) -> Estimates:
    """Return what the models of a profile say of its test trials; trains what is missing.

    Args:
        context: The run.
        profile: One of `MODELS`.

    Raises:
        MixtacError: Trials are missing or cannot be used.
    """
    sets = trial_sets(context.sizes, context.bags)
    models = MODELS[profile]
    tests = {seed: sets.tests(seed, profile) for seed in range(context.seeds)}
    weights = _train(context, models)
    pieces = [
        JudgePiece(seed, source, {model: weights[model, seed] for model in models})
        for seed in range(context.seeds)
        for source in tests[seed]
    ]
    found: Estimates = {model: {seed: [] for seed in range(context.seeds)} for model in models}
    results = context.run(f'{profile}: judging', pieces)
    for piece, result in zip(pieces, results, strict=True):
        for model, name in result['files'].items():
            found[model][piece.seed].append(load_estimate(context.pieces / name))
    return found


def _train(context: Context, models: Sequence[str]) -> dict[tuple[str, int], str]:
    """Train what is missing, and return the stem of the weight file by model and seed."""
    sets = trial_sets(context.sizes, context.bags)
    cache = context.folder / 'samples'
    pieces = [
        TrainPiece(model, seed, run_config(context.sizes, model, seed, sets.training(seed), cache))
        for seed in range(context.seeds)
        for model in models
    ]
    missing = [p for p in pieces if not (context.pieces / f'{stem_of(p)}.json').exists()]
    _prepare(context, missing)
    context.run('training', pieces)
    return {(piece.model, piece.seed): stem_of(piece) for piece in pieces}


def _prepare(context: Context, pieces: Sequence[TrainPiece]) -> None:
    """Prepare the samples before trainings run side by side, which would prepare them twice."""
    from mixtac_fger.train.data import training_sources
    from mixtac_fger.trials.preparation import prepare

    recipes: dict[str, tuple[Recipe, list[TrialSource]]] = {}
    for piece in pieces:
        recipe = _recipe(piece.config)
        key = json.dumps(recipe.fingerprint(), sort_keys=True)
        known = recipes.setdefault(key, (recipe, []))[1]
        names = {source.name for source in known}
        known += [s for s in training_sources(piece.config.data) if s.name not in names]
    for recipe, sources in recipes.values():
        bar = context.progress.add_task('preparing samples', total=len(sources))
        prepare(
            sources,
            recipe,
            context.folder / 'samples',
            context.jobs,
            partial(_show, context.progress, bar),
        )


def _show(progress: Progress, bar: TaskID, done: int) -> None:
    progress.update(bar, completed=done)


def _recipe(config: RunConfig) -> Recipe:
    """Return how the model of a run wants its samples."""
    from mixtac_fger.config import FgerConfig
    from mixtac_fger.paper.config import PaperConfig
    from mixtac_fger.paper.samples import PaperRecipe
    from mixtac_fger.trials.fger_recipe import FgerRecipe

    if config.model == OURS:
        return FgerRecipe(FgerConfig.from_dict(FgerConfig().to_dict() | config.network))
    return PaperRecipe(PaperConfig.from_dict({'model': config.model} | config.network))


def _data_version(data: DataConfig) -> str:
    """Return what changes when simulated or recorded data do."""
    if data.simulated is not None:
        return sensor_digest()
    return _bags_version([Path(bag) for bag in data.bags])


def _bags_version(bags: Sequence[Path]) -> str:
    """Return names, sizes and dates of the files of bags and of their clock fits."""
    files = [path for bag in bags for path in sorted(bag.iterdir())]
    files += [fit for bag in bags if (fit := bag.with_name(f'{bag.name}.clock_fit.json')).exists()]
    return json.dumps([(str(p), p.stat().st_size, p.stat().st_mtime_ns) for p in files])
