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

import numpy as np
import torch

from mixtac_core.recordings.bag import fit_path
from mixtac_core.recordings.recording import RecordingError
from mixtac_fger.weights import read_model, save_model
from mixtac_learning.experiments.harness import (
    PRESET,
    Context,
    Outcome,
    Row,
    Sizes,
    Value,
    run_config,
    texts,
)
from mixtac_learning.experiments.store import Piece, find_result
from mixtac_learning.judge.estimators import TrialEstimate, trial_estimator
from mixtac_learning.judge.metrics import Metrics, measure
from mixtac_learning.train.config import OURS, DataConfig, RunConfig, SimulatedData
from mixtac_learning.train.run import recipe_of, train_model, training_sources
from mixtac_learning.trials.bags import BagSource, bag_sources
from mixtac_learning.trials.store import CachedSource, Recipe, prepare
from mixtac_learning.trials.trial import SimulatedSource, TrialSource
from mixtac_sim.world.plans import TrialSpec, training_plan


class Model(NamedTuple):
    """How a model appears in reports."""

    label: str
    short: str
    colour: str


MODELS = {
    OURS: Model('FGER-Net, small (ours)', 'FGER-Net,\nsmall (ours)', '#0072b2'),
    'fger': Model("FGER-Net, the paper's layers", "FGER-Net,\npaper's layers", '#009e73'),
    'frames': Model('frames only', 'frames only', '#e69f00'),
    'events': Model('events only', 'events only', '#d55e00'),
    'fusion': Model('feature-level fusion', 'feature-level\nfusion', '#cc79a7'),
}
"""Colours that stay distinct without colour vision (Okabe and Ito 2008)."""
JUDGED = {
    'dynamic': (OURS, 'fger', 'frames', 'events'),
    'static': (OURS, 'fger', 'fusion'),
    'long_term': (OURS, 'fger'),
    'impact': (OURS, 'fger'),
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
LEARNING_CODE = (
    'mixtac_core.events',
    'mixtac_fger',
    'mixtac_core.recordings',
    'mixtac_fger.alignment',
    'mixtac_sim',
    *(f'mixtac_learning.{part}' for part in ('judge', 'network', 'paper', 'train', 'trials')),
)
"""Packages that a trained model and its estimates depend on."""


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
        """Whether all bags, or their descriptions, are marked as simulated."""
        origins = [bag.origin for name in PROFILES for part in self._split(name) for bag in part]
        return all(bool(o.get('simulated')) or 'trial_seed' in o for o in origins)

    def training(self, _seed: int) -> DataConfig:
        """Return the training bags of all profiles, the same for every seed.

        Raises:
            RecordingError: There are none.
        """
        bags = [bag for name in PROFILES for bag in self._split(name)[0]]
        if not bags:
            raise RecordingError(f'{self.folder} holds no bags for training', remedy=_REMEDY)
        return DataConfig(bags=tuple(str(bag.path) for bag in bags), checked=CHECKED)

    def tests(self, _seed: int, profile: str) -> Sequence[TrialSource]:
        """Return the test bags of a profile.

        Raises:
            RecordingError: There are none.
        """
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

    def _split(self, profile: str) -> tuple[list[BagSource], list[BagSource]]:
        folder = self.folder / profile
        split: tuple[list[BagSource], list[BagSource]] = [], []
        for index, bag in enumerate(bag_sources(folder) if folder.is_dir() else []):
            by_order = 'val' if index % SHARE_TESTED == SHARE_TESTED - 1 else 'train'
            held = bag.origin.get('split', by_order) != 'train'
            split[held].append(replace(bag, described=bag.described | {'profile': profile}))
        return split


def trial_sets(context: Context) -> SimulatedTrials | BagTrials:
    """Return simulated trials, or those of the user's bags."""
    return SimulatedTrials(context.sizes) if context.bags is None else BagTrials(context.bags)


_REMEDY = (
    f'record at least five trials into each of the folders {", ".join(PROFILES)}, with the'
    ' reference sensor, and align them'
)


def deviations(sizes: Sizes) -> tuple[str, ...]:
    """Return the differences from the paper wherever models are trained."""
    values = {'trials': sizes.trials, 'seconds': sizes.seconds}
    values |= sizes.paper_network | sizes.paper_training
    return tuple(each.format(**values) for each in texts('training')['deviations'])


def train(context: Context, configs: Mapping[tuple[str, int], RunConfig]) -> dict[Any, str]:
    """Train what is missing.

    Args:
        context: The run; samples are stored in its folder.
        configs: Training runs by model and seed.

    Returns:
        Stem of the weight file among the stored results, by model and seed.
    """
    pieces = {}
    for (model, seed), config in configs.items():
        files = tuple(path for bag in config.data.bags for path in _bag_files(Path(bag)))
        plain = replace(config, data=replace(config.data, cache=''))
        label = f'model_{model}_s{seed}'
        pieces[model, seed] = Piece(label, _train, (plain,), LEARNING_CODE, files)
    missing = [key for key in configs if find_result(context.pieces, pieces[key]) is None]
    _prepare(context, [configs[key] for key in missing])
    context.run('training', list(pieces.values()))
    return {key: piece.stem for key, piece in pieces.items()}


def _train(base: Path, config: RunConfig) -> dict[str, Any]:
    """Train and write the weight file; an interrupted training continues."""
    torch.set_num_threads(1)
    data = replace(config.data, cache=str(base.parents[1] / 'samples'))
    trained = train_model(replace(config, data=data), base)
    save_model(base.with_name(f'{base.name}.safetensors'), trained.model)
    return {'minutes': trained.model.card.training['minutes'], 'skipped': trained.skipped}


def _prepare(context: Context, configs: Iterable[RunConfig]) -> None:
    """Prepare the samples before trainings run side by side, which would prepare them twice."""
    recipes: dict[str, tuple[Recipe, dict[str, TrialSource]]] = {}
    for config in configs:
        recipe: Recipe = recipe_of(config)
        key = json.dumps(recipe.fingerprint(), sort_keys=True)
        sources = recipes.setdefault(key, (recipe, {}))[1]
        for source in training_sources(config.data):
            # Each network reads the trial anew, and simulating takes longer than reading.
            simulated = isinstance(source, SimulatedSource)
            kept = CachedSource(source, context.folder / 'trials') if simulated else source
            sources[source.name] = kept
    for recipe, sources in recipes.values():
        bar = context.progress.add_task('preparing samples', total=len(sources))
        folder = context.folder / 'samples'
        prepare([*sources.values()], recipe, folder, context.jobs, _updating(context, bar))


def _updating(context: Context, bar: Any) -> Callable[[int], None]:  # noqa: ANN401
    return lambda done: context.progress.update(bar, completed=done)


def estimates(context: Context, profile: str) -> Estimates:
    """Return the estimates of the models of a profile on its test trials; trains what is missing.

    Args:
        context: The run.
        profile: One of `JUDGED`.

    Raises:
        MixtacError: Trials are missing or cannot be used.
    """
    sets, models, seeds = trial_sets(context), JUDGED[profile], range(context.seeds)
    cases = [(seed, source) for seed in seeds for source in sets.tests(seed, profile)]
    configs = {
        (model, seed): run_config(context.sizes, model, seed, sets.training(seed))
        for seed in seeds
        for model in models
    }
    weights = train(context, configs)
    pieces = []
    for seed, source in cases:
        bags = _bag_files(source.path) if isinstance(source, BagSource) else ()
        arguments = (source, {model: weights[model, seed] for model in models})
        label = f'judged_s{seed}_{source.name}'
        pieces.append(Piece(label, _judge, arguments, LEARNING_CODE, bags))
    found: Estimates = {model: {seed: [] for seed in seeds} for model in models}
    results = context.run(f'{profile}: testing', pieces)
    for (seed, _), result in zip(cases, results, strict=True):
        for model, name in result['files'].items():
            found[model][seed].append(load_estimate(context.pieces / name))
    return found


def _judge(base: Path, source: TrialSource, weights: Mapping[str, str]) -> dict[str, Any]:
    """Estimate a trial, which is loaded once, with each model."""
    torch.set_num_threads(1)
    trial = source.load()
    files = {}
    for model, stem in weights.items():
        estimate = trial_estimator(read_model(base.parent / f'{stem}.safetensors'))(trial)
        files[model] = f'{base.name}_{model}.npz'
        save_estimate(base.parent / files[model], estimate)
    return {'files': files}


def save_estimate(path: Path, estimate: TrialEstimate) -> None:
    """Write an estimate to an npz file."""
    values = {each.name: getattr(estimate, each.name) for each in fields(estimate)}
    np.savez(path, **{name: value for name, value in values.items() if value is not None})


def load_estimate(path: Path) -> TrialEstimate:
    """Read what `save_estimate` wrote."""
    with np.load(path) as file:
        values = {name: file[name] for name in file.files}
    words = {name: str(value) for name, value in values.items() if value.ndim == 0}
    return TrialEstimate(**{'reference': None, **values, **words})


def _bag_files(bag: Path) -> tuple[Path, ...]:
    """Return the files of a bag and its clock fit."""
    fit = fit_path(bag)
    return *sorted(bag.iterdir()), *([fit] if fit.exists() else [])


def force_outcome(
    context: Context,
    profile: str,
    name: str,
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
    sets = trial_sets(context)
    found = estimates(context, profile)
    simulated, text = sets.simulated, texts(name)
    text['deviations'] = (*deviations(context.sizes), *text['deviations'])
    path = draw(context.figure(name), found, simulated=simulated)
    constant = Value.of(pooled(each).constant_mae for each in found[OURS].values())
    last = Row('best constant: MAE', constant, None, '', 'N', conditions, simulated)
    return Outcome(
        data=sets.describe(profile),
        rows=[*rows(found, simulated=simulated), last],
        figures={text.pop('caption'): path},
        **text,
    )


def pooled(estimates: Sequence[TrialEstimate]) -> Metrics:
    """Return the errors of all windows of some trials together."""
    known = np.concatenate([each.known for each in estimates])
    return measure(known, np.concatenate([each.force for each in estimates]))


def error_rows(
    name: str,
    by_seed: Mapping[int, Sequence[TrialEstimate]],
    paper: Mapping[str, float],
    place: str,
    conditions: str,
    *,
    simulated: bool,
) -> list[Row]:
    """Return MAE, RMSE and R2 of a model; one value per seed.

    Args:
        name: Display name of the model.
        by_seed: Its estimates by seed.
        paper: The paper's values by `mae`, `rmse`, `r2`, where it gives them.
        place: Section, figure or table of the paper.
        conditions: Which trials these are.
        simulated: Whether the data are simulated.
    """
    metrics = [pooled(estimates) for estimates in by_seed.values()]
    return [
        Row(
            f'{name}: {title}',
            Value.of(getattr(each, key) for each in metrics),
            paper.get(key),
            place if key in paper else '',
            unit,
            conditions,
            simulated,
        )
        for key, title, unit in (('mae', 'MAE', 'N'), ('rmse', 'RMSE', 'N'), ('r2', 'R2', ''))
    ]


def rate_hz(estimates: Sequence[TrialEstimate]) -> float:
    """Return the number of distinct forces per second [Hz]."""
    changes = sum(int(np.count_nonzero(np.diff(e.force))) for e in estimates)
    return changes / sum(1e-6 * float(e.t_us[-1] - e.t_us[0]) for e in estimates)
