# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Train models and run them on test trials, simulated or recorded.

Every force experiment calls `estimates`: it trains each model once per seed, runs it on the test
trials of one force profile, and stores weights and estimates, which all experiments of a run
share.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import torch

from mixtac_fger.config import FgerConfig
from mixtac_fger.weights import read_model, save_model
from mixtac_lab.experiments.harness import Context, constant_row
from mixtac_lab.experiments.report import Outcome, Row, texts
from mixtac_lab.experiments.sizes import (
    DYNAMIC,
    EVENTS,
    FGER,
    FRAMES,
    FUSION,
    HOLD,
    IMPACT,
    PRESET,
    STATIC,
    Sizes,
    run_config,
)
from mixtac_lab.store import Piece, code_version, files_version
from mixtac_learning.judge.estimators import TrialEstimate, trial_estimator
from mixtac_learning.paper.config import PaperConfig
from mixtac_learning.paper.samples import PaperRecipe
from mixtac_learning.train.config import OURS, DataConfig, RunConfig, SimulatedData
from mixtac_learning.train.run import train_model, training_sources
from mixtac_learning.trials.bags import BagSource, bag_sources
from mixtac_learning.trials.samples import FgerRecipe
from mixtac_learning.trials.simulated import SimulatedSource
from mixtac_learning.trials.store import CachedSource, Recipe, prepare, read_arrays, write_arrays
from mixtac_learning.trials.trial import TrialSource
from mixtac_recordings.bag import fit_path
from mixtac_recordings.recording import RecordingError
from mixtac_sim.world.plans import TrialSpec, simulator_digest, training_plan


class Model(NamedTuple):
    """How a model appears in reports."""

    label: str
    short: str
    colour: str


MODELS = {
    OURS: Model('FGER-Net, small (ours)', 'FGER-Net,\nsmall (ours)', '#0072b2'),
    FGER: Model("FGER-Net, the paper's layers", "FGER-Net,\npaper's layers", '#009e73'),
    FRAMES: Model('frames only', 'frames only', '#e69f00'),
    EVENTS: Model('events only', 'events only', '#d55e00'),
    FUSION: Model('feature-level fusion', 'feature-level\nfusion', '#cc79a7'),
}
"""Colours that stay distinct without colour vision (Okabe and Ito 2008)."""
JUDGED = {
    DYNAMIC: (OURS, FGER, FRAMES, EVENTS),
    STATIC: (OURS, FGER, FUSION),
    HOLD: (OURS, FGER),
    IMPACT: (OURS, FGER),
}
"""Models that are evaluated on each profile."""
Estimates = dict[str, dict[int, list[TrialEstimate]]]
"""Estimates by model and seed."""
PROFILES = tuple(JUDGED)
FIRST_DATA_SEED = 40
"""Data seeds of `mixtac_sim.world.plans`; other ones than those of shipped models."""
FIRST_TEST = 830_000
"""First trial seed of the tests; training uses 100,000 to 200,000."""
SHARE_TESTED = 5
"""One bag in this many is a test trial: 8:2 by trial, as in the paper."""
CHECKED = 1 / 8
"""Part of the training trials that the best weights are chosen by."""
_WORDS, _FACTS = ('name', 'profile', 'device'), 'trial.json'


def save_estimate(path: Path, estimate: TrialEstimate) -> None:
    """Write an estimate as a folder of arrays."""
    values = {each.name: getattr(estimate, each.name) for each in fields(estimate)}
    words = {name: values.pop(name) for name in _WORDS}
    arrays = {name: array for name, array in values.items() if array is not None}
    write_arrays(path, arrays, words, _FACTS)


def load_estimate(path: Path) -> TrialEstimate:
    """Read what `save_estimate` wrote."""
    arrays, words = read_arrays(path, _FACTS, ())
    return TrialEstimate(**{'reference': None, **arrays, **words})


@dataclass(frozen=True, slots=True)
class SimulatedTrials:
    """One simulated sensor per seed.

    Attributes:
        sizes: Numbers and lengths of the trials.
        simulated: Always true.
    """

    sizes: Sizes
    simulated: ClassVar = True

    def training(self, seed: int) -> DataConfig:
        """Return trials of the seed's sensor."""
        sizes = self.sizes
        data = SimulatedData(
            (PRESET,), 1, sizes.trials, sizes.seconds, sizes.mix, FIRST_DATA_SEED + seed
        )
        return DataConfig(simulated=data, checked=CHECKED)

    def tests(self, seed: int, profile: str) -> Sequence[TrialSource]:
        """Return other days of the same sensor."""
        count, seconds = self.sizes.tests[profile]
        device = training_plan(1, 1, 1.0, FIRST_DATA_SEED + seed, (PRESET,))[0].device_seed
        first = FIRST_TEST + 1000 * seed + 100 * PROFILES.index(profile)
        specs = [TrialSpec(device, first + k, profile, seconds, PRESET) for k in range(count)]
        return [SimulatedSource(spec) for spec in specs]

    def describe(self, profile: str) -> str:
        """Return sizes, preset and seeds."""
        sizes = self.sizes
        count, seconds = sizes.tests[profile]
        trained = ', '.join(dict.fromkeys(sizes.mix[: sizes.trials]))
        return (
            f'virtual sensor, preset {PRESET}; per seed one sensor, trained on {sizes.trials}'
            f' trials of {sizes.seconds:g} s ({trained}; data seeds from'
            f' {FIRST_DATA_SEED}), tested on {count} {profile} trials of {seconds:g} s on other'
            f' days (trial seeds from {FIRST_TEST})'
        )


@dataclass(frozen=True, slots=True)
class BagTrials:
    """A user's bags: one folder per profile, as `mixtac simulate --dataset NAME` writes them.

    A `dataset.yaml` decides which trials are for training; without one, every fifth trial is a
    test trial.

    Attributes:
        folder: Holds folders named `dynamic`, `static`, `long_term` and `impact`.
    """

    folder: Path

    @property
    def simulated(self) -> bool:
        """Whether all bags are marked as simulated."""
        return all(is_simulated(bag) for name in PROFILES for bag in self._bags(name))

    def training(self, seed: int) -> DataConfig:
        """Return the training bags of all profiles, the same for every seed.

        Raises:
            RecordingError: There are none.
        """
        del seed
        bags = [bag for name in PROFILES for bag in self._split(name)[0]]
        if not bags:
            raise RecordingError(f'{self.folder} holds no bags for training', remedy=_REMEDY)
        return DataConfig(bags=tuple(str(bag.path) for bag in bags), checked=CHECKED)

    def tests(self, seed: int, profile: str) -> Sequence[TrialSource]:
        """Return the test bags of a profile.

        Raises:
            RecordingError: There are none.
        """
        del seed
        held = self._split(profile)[1]
        if not held:
            raise RecordingError(
                f'{self.folder / profile} holds no bags for testing', remedy=_REMEDY
            )
        return held

    def describe(self, profile: str) -> str:
        """Return the folder and the numbers of bags."""
        trained, held = self._split(profile)
        total = sum(len(self._split(name)[0]) for name in PROFILES)
        kind = 'simulated bags' if self.simulated else 'recorded bags'
        return (
            f'{kind} in {self.folder.name}: {total} for training, of these {len(trained)}'
            f' {profile}; {len(held)} {profile} bags for testing, split by trial'
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
            named = replace(bag, described=bag.described | {'profile': profile})
            (trained if split == 'train' else held).append(named)
        return trained, held


def trial_sets(sizes: Sizes, bags: Path | None) -> SimulatedTrials | BagTrials:
    """Return simulated trials, or those of a folder of bags."""
    return SimulatedTrials(sizes) if bags is None else BagTrials(bags)


def is_simulated(bag: BagSource) -> bool:
    """Return whether a bag, or its description, is marked as simulated."""
    return bool(bag.origin.get('simulated')) or 'trial_seed' in bag.origin


_REMEDY = (
    f'record at least five trials into each of the folders {", ".join(PROFILES)}, with the'
    ' reference sensor, and align them'
)


def deviations(sizes: Sizes) -> tuple[str, ...]:
    """Return the differences from the paper wherever models are trained."""
    values = {'trials': sizes.trials, 'seconds': sizes.seconds}
    values |= sizes.paper_network | sizes.paper_training
    return tuple(each.format(**values) for each in texts('training')['deviations'])


def learning_version() -> str:
    """Return the version of simulator, networks, training and the reading of bags."""
    networks = code_version('mixtac_events', 'mixtac_fger', 'mixtac_learning')
    bags = code_version('mixtac_recordings', 'mixtac_alignment')
    return f'{simulator_digest()} {networks} {bags}'


def train(context: Context, configs: Mapping[tuple[str, int], RunConfig]) -> dict[Any, str]:
    """Train what is missing.

    Args:
        context: The run; samples are stored in its folder.
        configs: Training runs by model and seed.

    Returns:
        Stem of the weight file in the store, by model and seed.
    """
    pieces = {}
    for (model, seed), config in configs.items():
        bags = [path for bag in config.data.bags for path in _bag_files(Path(bag))]
        version = f'{learning_version()} {files_version(bags)}'
        plain = replace(config, data=replace(config.data, cache=''))
        pieces[model, seed] = Piece(f'model_{model}_s{seed}', _train, (plain,), version)
    missing = [configs[key] for key, piece in pieces.items() if context.store.find(piece) is None]
    _prepare(context, missing)
    context.run('training', list(pieces.values()))
    return {key: piece.stem for key, piece in pieces.items()}


def _train(base: Path, config: RunConfig) -> dict[str, Any]:
    """Train and write the weight file; an interrupted training continues."""
    torch.set_num_threads(1)
    data = replace(config.data, cache=str(_samples(base.parent)))
    trained = train_model(replace(config, data=data), base)
    save_model(base.with_name(f'{base.name}.safetensors'), trained.model)
    return {'minutes': trained.model.card.training['minutes'], 'skipped': trained.skipped}


def _samples(store: Path) -> Path:
    return store.parent / 'samples'


def _prepare(context: Context, configs: Iterable[RunConfig]) -> None:
    """Prepare the samples before trainings run side by side, which would prepare them twice."""
    recipes: dict[str, tuple[Recipe, dict[str, TrialSource]]] = {}
    for config in configs:
        recipe = _recipe(config)
        key = json.dumps(recipe.fingerprint(), sort_keys=True)
        sources = recipes.setdefault(key, (recipe, {}))[1]
        for source in training_sources(config.data):
            # Each network reads the trial anew, and simulating takes longer than reading.
            simulated = isinstance(source, SimulatedSource)
            kept = CachedSource(source, context.folder / 'trials') if simulated else source
            sources[source.name] = kept
    for recipe, sources in recipes.values():
        bar = context.progress.add_task('preparing samples', total=len(sources))
        folder = _samples(context.store.folder)
        prepare([*sources.values()], recipe, folder, context.jobs, _updating(context, bar))


def _updating(context: Context, bar: Any) -> Callable[[int], None]:  # noqa: ANN401
    return lambda done: context.progress.update(bar, completed=done)


def _recipe(config: RunConfig) -> Recipe:
    """Return how the model of a run needs its samples."""
    if config.model == OURS:
        network = FgerConfig.from_dict(FgerConfig().to_dict() | config.network)
        return FgerRecipe(network, config.data.label)
    paper = PaperConfig.from_dict({'model': config.model} | config.network)
    return PaperRecipe(paper, config.data.label)


def estimates(context: Context, profile: str) -> Estimates:
    """Return the estimates of the models of a profile on its test trials; trains what is missing.

    Args:
        context: The run.
        profile: One of `JUDGED`.

    Raises:
        MixtacError: Trials are missing or cannot be used.
    """
    sets = trial_sets(context.sizes, context.bags)
    models, seeds = JUDGED[profile], range(context.seeds)
    tests = {seed: sets.tests(seed, profile) for seed in seeds}
    weights = train(
        context,
        {
            (model, seed): run_config(context.sizes, model, seed, sets.training(seed))
            for seed in seeds
            for model in models
        },
    )
    cases = [(seed, source) for seed in seeds for source in tests[seed]]
    pieces = []
    for seed, source in cases:
        bags = _bag_files(source.path) if isinstance(source, BagSource) else []
        version = f'{learning_version()} {files_version(bags)}'
        arguments = (source, {model: weights[model, seed] for model in models})
        pieces.append(Piece(f'judged_s{seed}_{source.name}', _judge, arguments, version))
    found: Estimates = {model: {seed: [] for seed in seeds} for model in models}
    results = context.run(f'{profile}: testing', pieces)
    for (seed, _), result in zip(cases, results, strict=True):
        for model, name in result['files'].items():
            found[model][seed].append(load_estimate(context.store.folder / name))
    return found


def _judge(base: Path, source: TrialSource, weights: Mapping[str, str]) -> dict[str, Any]:
    """Estimate a trial, which is loaded once, with each model."""
    torch.set_num_threads(1)
    trial = source.load()
    files = {}
    for model, stem in weights.items():
        estimate = trial_estimator(read_model(base.parent / f'{stem}.safetensors'))(trial)
        files[model] = f'{base.name}_{model}'
        save_estimate(base.parent / files[model], estimate)
    return {'files': files}


def _bag_files(bag: Path) -> list[Path]:
    """Return the files of a bag and its clock fit."""
    fit = fit_path(bag)
    return [*sorted(bag.iterdir()), *([fit] if fit.exists() else [])]


def force_outcome(
    context: Context,
    profile: str,
    name: str,
    *,
    rows: Callable[..., list[Row]],
    draw: Callable[..., Path],
    conditions: str,
) -> Outcome:
    """Return the outcome of an experiment that compares models on one profile.

    Args:
        context: The run.
        profile: One of `JUDGED`.
        name: Name of the experiment.
        rows: Returns the rows of the experiment from the estimates and `simulated`, whether the
            trials are simulated.
        draw: Writes the figure to a path, from the same.
        conditions: Which trials these are, for the row of the best constant.

    Raises:
        MixtacError: Trials are missing or cannot be used.
    """
    sets = trial_sets(context.sizes, context.bags)
    found = estimates(context, profile)
    simulated, text = sets.simulated, texts(name)
    text['deviations'] = (*deviations(context.sizes), *text['deviations'])
    path = draw(context.figures / f'{name}.png', found, simulated=simulated)
    constant = constant_row(found[OURS], conditions, simulated=simulated)
    return Outcome(
        data=sets.describe(profile),
        rows=[*rows(found, simulated=simulated), constant],
        figures={text.pop('caption'): path},
        **text,
    )
