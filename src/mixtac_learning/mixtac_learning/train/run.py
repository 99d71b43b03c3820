# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A training run from its configuration to weight file, model card, curves and figures."""

from __future__ import annotations

import hashlib
import random
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import torch
from rich.progress import Progress, TaskID

from mixtac_core.events.errors import MixtacError
from mixtac_core.node.files import write_json
from mixtac_fger.config import FgerConfig, from_mapping
from mixtac_fger.fger_net import checked_config
from mixtac_fger.weights import Model, ModelCard, find_model, read_model, save_model
from mixtac_learning.judge.estimators import judge_sources, trial_estimator
from mixtac_learning.judge.metrics import by_profile
from mixtac_learning.judge.report import judge_devices, show_figures, show_skipped
from mixtac_learning.network import model_of, network_of
from mixtac_learning.paper.config import PaperConfig
from mixtac_learning.paper.networks import paper_model_of
from mixtac_learning.paper.samples import PaperSample, paper_recipe
from mixtac_learning.train import loop
from mixtac_learning.train.config import OURS, DataConfig, RunConfig, TrainingSettings
from mixtac_learning.train.paper_stage import PaperTraining, train_paper
from mixtac_learning.train.sequences import DiskGroups
from mixtac_learning.train.stages import train_fger
from mixtac_learning.trials.bags import TrialSource, bag_sources
from mixtac_learning.trials.samples import Recipe, fger_recipe, load_sample, prepare
from mixtac_learning.trials.trial import DatasetError, SimulatedSource, sensor_of
from mixtac_sim.world import plans as generation
from mixtac_sim.world.plans import TRAINING_PROFILES, session_plan, training_plan, unseen_devices


def recipe_of(config: RunConfig) -> Recipe:
    """Return how the network of a run needs its samples.

    Raises:
        ConfigError: A field of the network is unknown or impossible.
        ModelError: The weight file to start from cannot be used.
    """
    if config.start:
        return fger_recipe(checked_config(read_model(find_model(config.start))))
    if config.model == OURS:
        return fger_recipe(FgerConfig.from_dict(asdict(FgerConfig()) | config.network))
    return paper_recipe(PaperConfig.from_dict({'model': config.model} | config.network))


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
            wanted.presets,
            wanted.profiles or TRAINING_PROFILES,
        )
        if wanted.session:
            plan = session_plan(wanted.session, wanted.seed, wanted.presets[0])[0]
        found += [SimulatedSource(spec) for spec in plan]
    for folder in data.bags:
        bags = bag_sources(Path(folder).expanduser(), data.reference)
        found += [bag for bag in bags if bag.origin.get('split', 'train') == 'train']
    return found


def held_out(sensors: Mapping[int, str], part: float) -> list[int]:
    """Return the numbers of the trials to validate on, ascending; the same for the same sensors.

    They are drawn at random: presets and profiles take turns, and every n-th trial might be all
    there is of one of them. All trials of a sensor are held out together, where there are sensors
    enough: the errors on a sensor that was trained on say little about another one.

    Args:
        sensors: Which sensor each trial was made with, by the number of the trial.
        part: Part of them, 0 for none; at least one is left to train on.
    """
    if part <= 0.0:
        return []
    different = list(dict.fromkeys(sensors.values()))
    if part * len(different) < 1.0:
        different = [str(index) for index in sensors]
        sensors = dict(zip(sensors, different, strict=True))
    size = min(max(round(part * len(different)), 1), len(different) - 1)
    drawn = set(random.Random(0).sample(different, size))  # noqa: S311  (no secret)
    return [index for index, sensor in sensors.items() if sensor in drawn]


def provenance(
    config: RunConfig, sources: Sequence[TrialSource], settings: dict[str, Any]
) -> dict[str, Any]:
    """Return the description of the training for the weight file, JSON-ready.

    Args:
        config: The run.
        sources: Trials that are trained on.
        settings: All its training settings.
    """
    origins = [source.origin for source in sources]
    simulated = all(origin.get('simulated') or 'trial_seed' in origin for origin in origins)
    found: dict[str, Any] = {
        'model': config.model,
        'data': 'simulated (mixtac_sim)' if simulated else 'bags',
        'trials': len(sources),
        'profiles': sorted({str(origin.get('profile', 'unknown')) for origin in origins}),
        'settings': settings,
    }
    if config.data.simulated is not None:
        found['simulator'] = generation.simulator_digest()
        found['seconds'] = config.data.simulated.seconds
        found['preset'] = ', '.join(dict.fromkeys(config.data.simulated.presets))
    if config.start:
        found['start'] = config.start
    if config.data.bags:
        found['bags'] = sorted(str(origin.get('name')) for origin in origins)
    for key in ('device_seed', 'trial_seed'):
        if seeds := sorted(int(origin[key]) for origin in origins if key in origin):
            found[f'{key}s'] = [seeds[0], seeds[-1]]
    return found


@dataclass(frozen=True, slots=True, eq=False)
class Trained:
    """The result of a run.

    Attributes:
        model: Content of its weight file, without figures.
        curves: One row per epoch.
        held: Trials that were held out.
        skipped: Why a trial was left out, by its name.
    """

    model: Model
    curves: list[dict[str, Any]]
    held: list[TrialSource]
    skipped: dict[str, str]


def train_model(
    config: RunConfig,
    folder: Path | None = None,
    *,
    jobs: int = 1,
    show: loop.Show = lambda *_: None,
) -> Trained:
    """Train as a configuration describes, and write the curves; whole trials are held out.

    Of the processes that share the training one prepares the samples, and the others find them.

    Args:
        config: The run.
        folder: Checkpoint and curves; None keeps nothing, so that an interrupted run starts over.
        jobs: Processes that prepare samples.
        show: Called while samples are prepared, and after each epoch.

    Raises:
        ConfigError: A setting is unknown or impossible.
        DatasetError: No trial can be used.
        TrainingError: The folder is another run's, or training fails.
    """
    leads, recipe = loop.rank() == 0, recipe_of(config)
    kind = TrainingSettings if config.model == OURS else PaperTraining
    settings: Any = from_mapping(kind, config.training, 'training')
    sources = training_sources(config.data)
    if not leads:
        loop.wait()
    found, skipped = prepare(
        sources,
        [recipe],
        Path(config.data.cache),
        jobs if leads else 1,
        lambda done: show('preparing', done, len(sources), 'preparing'),
    )
    if leads:
        loop.wait()
    sensors = {index: sensor_of(sources[index].origin, f'trial {index}') for index in found}
    held = held_out(sensors, config.data.checked)
    trained = [index for index in found if index not in held]
    paths, checked = ([found[index][0] for index in part] for part in (trained, held))
    text = f'{config.fingerprint()} {[path.name for path in (*paths, *checked)]} {loop.world()}'
    shared: dict[str, Any] = {
        'show': show,
        'checkpoint': None if folder is None else folder / 'checkpoint.safetensors',
        'fingerprint': hashlib.blake2b(text.encode(), digest_size=16).hexdigest(),
    }
    if config.model == OURS:
        size, start = settings.group_trials, None
        if config.start:
            start = network_of(read_model(find_model(config.start)))
            if not checked:
                raise DatasetError('one trial cannot be held back', remedy='record two or more')
        groups = DiskGroups(paths, size, loop.share(range(len(paths))))
        others = DiskGroups(checked, size) if checked else None
        network, curves = train_fger(recipe.config, settings, groups, others, start=start, **shared)
        model = model_of(network, ModelCard({}))
    else:
        own, other = (
            [load_sample(path, PaperSample) for path in part] for part in (paths, checked)
        )
        paper, curves = train_paper(recipe.config, settings, own, other, **shared)
        model = paper_model_of(paper, ModelCard({}))
    used = [sources[index] for index in trained]
    training = provenance(config, used, asdict(settings)) | {
        'held_out_trials': len(held),
        'skipped_trials': skipped,
        'minutes': round(sum(row['seconds'] for row in curves) / 60, 1),
        'core_minutes': round(sum(row['core_seconds'] for row in curves) / 60, 2),
        'processes': loop.world(),
    }
    if folder is not None and leads:
        write_json(folder / 'curves.json', {'epochs': curves})
    model = replace(model, card=ModelCard(training))
    return Trained(model, curves, [sources[index] for index in held], skipped)


EVALUATION_SECONDS = 10.0


def run_training(config: RunConfig, folder: Path | None, jobs: int, json: Path | None) -> None:
    """Carry out a run with a progress bar, judge the model, write it.

    Args:
        config: The run.
        folder: Checkpoint and curves; None for one below `runs` that is named after the settings,
            so that the same command resumes an interrupted run.
        jobs: Processes that prepare samples.
        json: Write the figures there as well; None for nowhere.

    Raises:
        MixtacError: As `train_model`, or a file cannot be written.
    """
    loop.join_processes()
    # Small networks: more threads wait for each other longer than they help.
    torch.set_num_threads(1)
    if folder is None:
        digest = hashlib.blake2b(config.fingerprint().encode(), digest_size=4).hexdigest()
        folder = Path('runs') / f'train_{config.model}_{digest}'
    with Progress(disable=loop.rank() > 0) as progress:
        bars: dict[str, TaskID] = {}

        def show(name: str, done: int, total: int, text: str) -> None:
            if name not in bars:
                bars[name] = progress.add_task(name, total=total)
            progress.update(bars[name], completed=done, description=text)

        trained = train_model(config, folder, jobs=jobs, show=show)
    if loop.rank() == 0:
        show_skipped(trained.skipped)
        _judge_and_write(config, trained, json)
    loop.leave_processes()


def _judge_and_write(config: RunConfig, trained: Trained, json: Path | None) -> None:
    """Write a model, judge it, and write it again with its figures."""
    # The weights first: training took its time, and not every model can be judged.
    save_model(Path(config.out), trained.model)
    metrics: dict[str, Any] = {}
    try:
        metrics = judge_trained(config, trained)
    except MixtacError as error:
        print(f'not judged: {error}')
    for title, figures in metrics.items():
        where = ', trials held back' if config.start else ''
        show_figures(title.replace('_', ' ') + where, figures)
    training = trained.model.card.training
    save_model(Path(config.out), replace(trained.model, card=ModelCard(training, metrics)))
    print(f'wrote {config.out}')
    content = {'model': config.out, 'run': asdict(config), 'training': training}
    write_json(json, content | {'metrics': metrics})


def judge_trained(config: RunConfig, trained: Trained) -> dict[str, Any]:
    """Return the figures of a model.

    Returns:
        Figures by profile: of an adapted model on the trials that were held back, `before` and
        `after`; of one that was trained on simulated trials on other sensors, `unseen_devices`;
        else nothing.

    Raises:
        MixtacError: The model gives no estimate, or sees no press.
    """
    estimator, data = trial_estimator(trained.model), config.data.simulated
    if config.start:
        before = trial_estimator(read_model(find_model(config.start)))
        return {
            name: by_profile(judge_sources(each, trained.held)[0])
            for name, each in (('before', before), ('after', estimator))
        }
    if data is None or config.judged < 1:
        return {}
    devices, preset = unseen_devices(config.judged, 0), data.presets[0]
    _, content = judge_devices(estimator, devices, EVALUATION_SECONDS, 1, preset)
    return dict(content['metrics'])
