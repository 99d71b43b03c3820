# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Train models and run them on test trials, simulated or recorded.

Every force experiment calls `estimates`: it trains each model once per seed, runs it on the test
trials of one force profile, and stores weights and estimates, which all experiments of a run
share.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from mixtac_lab.experiments.sizes import DYNAMIC, HOLD, IMPACT, PRESET, STATIC, TRAINED
from mixtac_lab.store import sensor_digest, stem_of, tell
from mixtac_learning.judge.estimators import TrialEstimate
from mixtac_learning.train.config import OURS, DataConfig, RunConfig, SimulatedData
from mixtac_learning.trials.bags import BagSource, bag_sources
from mixtac_learning.trials.simulated import SimulatedSource
from mixtac_recordings.recording import RecordingError
from mixtac_sim.world.training_trials import TrialSpec, training_plan

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.progress import Progress, TaskID

    from mixtac_lab.experiments.harness import Context
    from mixtac_lab.experiments.sizes import Sizes
    from mixtac_learning.trials.store import Recipe
    from mixtac_learning.trials.trial import TrialSource


_ARRAYS = ('t_us', 'force', 'known', 'reference', 'frames_only')


def save_estimate(path: Path, estimate: TrialEstimate) -> None:
    """Write an estimate as an npz file."""
    arrays = {name: getattr(estimate, name) for name in _ARRAYS}
    words = json.dumps([estimate.name, estimate.profile, estimate.device])
    kept = {name: array for name, array in arrays.items() if array is not None}
    np.savez_compressed(path, words=np.array(words), **kept)


def load_estimate(path: Path) -> TrialEstimate:
    """Read what `save_estimate` wrote."""
    with np.load(path, allow_pickle=False) as kept:
        name, profile, device = json.loads(str(kept['words']))
        arrays: dict[str, Any] = {each: kept.get(each) for each in _ARRAYS}
    return TrialEstimate(name=name, profile=profile, device=device, **arrays)


PROFILES = (DYNAMIC, STATIC, HOLD, IMPACT)
FIRST_DATA_SEED = 40
"""Data seeds of `mixtac_sim.world.training_trials`, apart from those of shipped models."""
FIRST_TEST = 830_000
"""First trial seed of the tests; training uses 100,000 to 200,000."""
SHARE_TESTED = 5
"""One bag in so many is judged on: 8:2 by trial, as in the paper."""


class TrialSets(Protocol):
    """Where training and test trials come from; must survive being sent to another process."""

    @property
    def simulated(self) -> bool:
        """Whether the trials are simulated."""

    def training(self, seed: int) -> DataConfig:
        """Return what the models of a seed are trained on."""

    def tests(self, seed: int, profile: str) -> Sequence[TrialSource]:
        """Return trials of a profile that no model of the seed was trained on.

        Raises:
            MixtacError: There are none.
        """

    def describe(self, profile: str) -> str:
        """Return the data set in words."""


@dataclass(frozen=True, slots=True)
class SimulatedTrials:
    """One simulated sensor per seed.

    Attributes:
        sizes: How many and how long.
    """

    sizes: Sizes

    @property
    def simulated(self) -> bool:
        """Yes."""
        return True

    def training(self, seed: int) -> DataConfig:
        """Return trials of the seed's sensor."""
        sizes = self.sizes
        data = SimulatedData(
            PRESET, 1, sizes.trials, sizes.seconds, TRAINED, FIRST_DATA_SEED + seed
        )
        return DataConfig(simulated=data, checked=0.0)

    def tests(self, seed: int, profile: str) -> Sequence[TrialSource]:
        """Return other days of the same sensor."""
        count, seconds = self.sizes.tests[profile]
        device = training_plan(1, 1, 1.0, FIRST_DATA_SEED + seed, PRESET)[0].device_seed
        first = FIRST_TEST + 1000 * seed + 100 * PROFILES.index(profile)
        specs = [TrialSpec(device, first + k, profile, seconds, PRESET) for k in range(count)]
        return [SimulatedSource(spec) for spec in specs]

    def describe(self, profile: str) -> str:
        """Return sizes, preset and seeds."""
        sizes = self.sizes
        count, seconds = sizes.tests[profile]
        trained = ', '.join(dict.fromkeys(TRAINED[: sizes.trials]))
        return (
            f'virtual sensor, preset {PRESET}; per seed one sensor, trained on {sizes.trials}'
            f' trials of {sizes.seconds:g} s ({trained}; data seeds from'
            f' {FIRST_DATA_SEED}), judged on {count} {profile} trials of {seconds:g} s of other'
            f' days (trial seeds from {FIRST_TEST})'
        )


@dataclass(frozen=True, slots=True)
class BagTrials:
    """A user's bags: one folder per profile, as `mixtac simulate --dataset NAME` makes them.

    Trials that a `dataset.yaml` gives to a split stay there; of the others every fifth is
    judged on and the rest is trained on.

    Attributes:
        folder: Holds folders named `dynamic`, `static`, `long_term` and `impact`.
    """

    folder: Path

    @property
    def simulated(self) -> bool:
        """Whether all bags say that they are."""
        return all(is_simulated(bag) for name in PROFILES for bag in self._bags(name))

    def training(self, seed: int) -> DataConfig:
        """Return the training bags of all profiles, for every seed the same.

        Raises:
            RecordingError: There are none.
        """
        del seed
        bags = [bag for name in PROFILES for bag in self._split(name)[0]]
        if not bags:
            raise RecordingError(f'{self.folder} holds no bags to train on: {_remedy()}')
        return DataConfig(bags=tuple(str(bag.path) for bag in bags), checked=0.0)

    def tests(self, seed: int, profile: str) -> Sequence[TrialSource]:
        """Return the bags of a profile that were held out.

        Raises:
            RecordingError: There are none.
        """
        del seed
        held = self._split(profile)[1]
        if not held:
            raise RecordingError(f'{self.folder / profile} holds no bags to judge on: {_remedy()}')
        return held

    def describe(self, profile: str) -> str:
        """Return the folder and how many bags there are."""
        trained, held = self._split(profile)
        total = sum(len(self._split(name)[0]) for name in PROFILES)
        kind = 'simulated bags' if self.simulated else 'recorded bags'
        return (
            f'{kind} in {self.folder.name}: {total} trained on, of these {len(trained)} {profile};'
            f' {len(held)} {profile} bags judged on, split by trial'
        )

    def _bags(self, profile: str) -> list[BagSource]:
        folder = self.folder / profile
        return bag_sources(folder) if folder.is_dir() else []

    def _split(self, profile: str) -> tuple[list[BagSource], list[BagSource]]:
        trained: list[BagSource] = []
        held: list[BagSource] = []
        for index, bag in enumerate(self._bags(profile)):
            by_order = 'val' if index % SHARE_TESTED == SHARE_TESTED - 1 else 'train'
            split = bag.origin.get('split', by_order)
            fields = dict(bag.described) | {'profile': profile}
            named = replace(bag, described=tuple(sorted(fields.items())))
            (trained if split == 'train' else held).append(named)
        return trained, held


def trial_sets(sizes: Sizes, bags: Path | None) -> SimulatedTrials | BagTrials:
    """Return simulated trials, or those of a folder of bags."""
    return SimulatedTrials(sizes) if bags is None else BagTrials(bags)


def is_simulated(bag: BagSource) -> bool:
    """Return whether a bag, or what describes it, says that it was simulated."""
    return bool(bag.origin.get('simulated')) or 'trial_seed' in bag.origin


def _remedy() -> str:
    return (
        f'record at least five trials into each of the folders {", ".join(PROFILES)}, with the'
        ' reference sensor, and align them'
    )


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

        from mixtac_learning.train.run import Run, save
        from mixtac_sim.world import training_trials as generation

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

        from mixtac_fger.weights import read_model
        from mixtac_learning.judge.estimators import trial_estimator

        torch.set_num_threads(1)
        trial = self.source.load()
        files = {}
        for model, weights in self.weights.items():
            estimate = trial_estimator(read_model(folder / f'{weights}.safetensors'))(trial)
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
    from mixtac_learning.train.run import training_sources
    from mixtac_learning.trials.store import prepare

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
    from mixtac_learning.paper.config import PaperConfig
    from mixtac_learning.paper.samples import PaperRecipe
    from mixtac_learning.trials.samples import FgerRecipe

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
