# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A training run from its configuration to weight file, model card, curves and figures."""

from __future__ import annotations

import hashlib
import random
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import torch
from rich.console import Console
from rich.progress import Progress, TaskID

from mixtac_core.events.errors import MixtacError
from mixtac_core.node.files import write_json
from mixtac_fger.config import FgerConfig, from_mapping
from mixtac_fger.fger_net import checked_config
from mixtac_fger.weights import Model, ModelCard, find_model, read_model, save_model
from mixtac_learning.judge.estimators import judge_sources, trial_estimator
from mixtac_learning.judge.report import (
    by_profile,
    judge_devices,
    show_figures,
    show_skipped,
)
from mixtac_learning.network import model_of, network_of, usual_device
from mixtac_learning.paper.config import PaperConfig
from mixtac_learning.paper.networks import paper_model_of
from mixtac_learning.paper.samples import PaperRecipe, load_paper_sample
from mixtac_learning.train.config import OURS, DataConfig, RunConfig, TrainingSettings
from mixtac_learning.train.frame_stage import DiskGroups
from mixtac_learning.train.loop import Processes, Report, TrainingError
from mixtac_learning.train.paper_stage import PaperTraining, train_paper
from mixtac_learning.train.stages import train_fger
from mixtac_learning.trials.bags import bag_sources
from mixtac_learning.trials.samples import FgerRecipe, prepare
from mixtac_learning.trials.trial import DatasetError, SimulatedSource, TrialSource, sensor_of
from mixtac_sim.world import plans as generation
from mixtac_sim.world.plans import (
    TRAINING_PROFILES,
    session_plan,
    training_plan,
    unseen_devices,
)


def recipe_of(config: RunConfig) -> FgerRecipe | PaperRecipe:
    """Return how the network of a run needs its samples.

    Raises:
        ConfigError: A field of the network is unknown or impossible.
        ModelError: The weight file to start from cannot be used.
    """
    if config.start:
        network = checked_config(read_model(find_model(config.start)))
        return FgerRecipe(network)
    if config.model == OURS:
        network = FgerConfig.from_dict(FgerConfig().to_dict() | config.network)
        return FgerRecipe(network)
    paper = PaperConfig.from_dict({'model': config.model} | config.network)
    return PaperRecipe(paper)


@dataclass(frozen=True, slots=True)
class TrainingData:
    """Samples of a run.

    Attributes:
        trained: Files to train on.
        checked: Files to validate on.
        sources: Where the samples to train on came from.
        held: Where the samples to validate on came from.
        skipped: Why a trial was left out, by its name.
    """

    trained: list[Path]
    checked: list[Path]
    sources: list[TrialSource]
    held: list[TrialSource]
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


def gather(
    data: DataConfig,
    recipe: FgerRecipe | PaperRecipe,
    jobs: int,
    on_progress: Callable[[int, int], None],
    processes: Processes,
) -> TrainingData:
    """Prepare the samples of a run; whole trials are held out, drawn at random.

    Args:
        data: What to train on.
        recipe: Recipe of the samples.
        jobs: Processes that prepare.
        on_progress: Called with the number of trials done and of all.
        processes: Processes that share the training; one prepares, the others find the files.

    Raises:
        DatasetError: No trial can be used.
    """
    sources, folder = training_sources(data), Path(data.cache)
    if not processes.leads:
        processes.wait()
    own_jobs = jobs if processes.leads else 1
    prepared = prepare(
        sources, [recipe], folder, own_jobs, lambda done: on_progress(done, len(sources))
    )
    if processes.leads:
        processes.wait()
    sensors = [sensor_of(sources[kept].origin, f'trial {kept}') for kept in prepared.kept]
    held = held_out(sensors, data.checked)
    paths = [path for (path,) in prepared.paths]
    trained = [index for index in range(len(paths)) if index not in held]
    return TrainingData(
        [paths[index] for index in trained],
        [paths[index] for index in held],
        [sources[prepared.kept[index]] for index in trained],
        [sources[prepared.kept[index]] for index in held],
        prepared.skipped,
    )


def held_out(sensors: Sequence[str], part: float) -> list[int]:
    """Return the numbers of the trials to validate on, ascending; the same for the same sensors.

    They are drawn at random: presets and profiles take turns, and every n-th trial might be all
    there is of one of them. All trials of a sensor are held out together, where there are sensors
    enough: the errors on a sensor that was trained on say little about another one.

    Args:
        sensors: Which sensor each trial was made with.
        part: Part of them, 0 for none; at least one is left to train on.
    """
    if part <= 0.0:
        return []
    different = list(dict.fromkeys(sensors))
    if part * len(different) < 1.0:
        different, sensors = (list(map(str, range(len(sensors)))) for _ in range(2))
    size = min(max(round(part * len(different)), 1), len(different) - 1)
    drawn = set(random.Random(0).sample(different, size))  # noqa: S311  (no secret)
    return [index for index, sensor in enumerate(sensors) if sensor in drawn]


def provenance(config: RunConfig, data: TrainingData, settings: dict[str, Any]) -> dict[str, Any]:
    """Return the description of the training for the weight file, JSON-ready.

    Args:
        config: The run.
        data: Its samples.
        settings: All its training settings.
    """
    origins = [source.origin for source in data.sources]
    simulated = all(origin.get('simulated') or 'trial_seed' in origin for origin in origins)
    found: dict[str, Any] = {
        'model': config.model,
        'data': 'simulated (mixtac_sim)' if simulated else 'bags',
        'trials': len(data.trained),
        'held_out_trials': len(data.checked),
        'skipped_trials': data.skipped,
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
    for key, plural in (('device_seed', 'device_seeds'), ('trial_seed', 'trial_seeds')):
        seeds = sorted(int(origin[key]) for origin in origins if key in origin)
        if seeds:
            found[plural] = [seeds[0], seeds[-1]]
    return found


CHECKPOINT = 'checkpoint.safetensors'


@dataclass(frozen=True, slots=True, eq=False)
class Trained:
    """The result of a run.

    Attributes:
        model: Content of its weight file, without figures.
        curves: One row per epoch.
        data: Trials that it was trained on, held back, and left out.
    """

    model: Model
    curves: list[dict[str, Any]]
    data: TrainingData


def train_model(
    config: RunConfig,
    folder: Path | None = None,
    *,
    jobs: int = 1,
    report: Report = lambda *_: None,
    on_progress: Callable[[int, int], None] = lambda _done, _total: None,
    processes: Processes | None = None,
) -> Trained:
    """Train as a configuration describes, and write the curves.

    Args:
        config: The run.
        folder: Checkpoint and curves; None keeps nothing, so that an interrupted run starts over.
        jobs: Processes that prepare samples.
        report: Called after each epoch.
        on_progress: Called while samples are prepared, with the number done and of all.
        processes: Processes that share the training; None for this one.

    Raises:
        ConfigError: A setting is unknown or impossible.
        DatasetError: No trial can be used.
        TrainingError: The folder is another run's, or training fails.
    """
    together, device, recipe = (
        processes or Processes(),
        chosen_device(config.device),
        recipe_of(config),
    )
    kind = TrainingSettings if config.model == OURS else PaperTraining
    settings: Any = from_mapping(kind, config.training, 'training')
    data = gather(config.data, recipe, jobs, on_progress, together)
    names = [path.name for path in (*data.trained, *data.checked)]
    text = f'{config.fingerprint()} {names} {together.world}'
    shared: dict[str, Any] = {
        'device': device,
        'processes': together,
        'report': report,
        'checkpoint': None if folder is None else folder / CHECKPOINT,
        'fingerprint': hashlib.blake2b(text.encode(), digest_size=16).hexdigest(),
    }
    if isinstance(recipe, FgerRecipe):
        own, size = together.share(range(len(data.trained))), settings.group_trials
        groups = DiskGroups(data.trained, recipe.config, size, own)
        held = DiskGroups(data.checked, recipe.config, size) if data.checked else None
        start = network_of(read_model(find_model(config.start))) if config.start else None
        if start is not None and held is None:
            raise DatasetError('one trial cannot be held back', remedy='record two or more')
        network, curves = train_fger(recipe.config, settings, groups, held, start=start, **shared)
        model = model_of(network, ModelCard({}))
    else:
        samples, checked = (
            [load_paper_sample(path) for path in paths] for paths in (data.trained, data.checked)
        )
        paper, curves = train_paper(recipe.config, settings, samples, checked, **shared)
        model = paper_model_of(paper, ModelCard({}))
    training = provenance(config, data, asdict(settings)) | {
        'minutes': round(sum(row['seconds'] for row in curves) / 60, 1),
        'core_minutes': round(sum(row['core_seconds'] for row in curves) / 60, 2),
        'processes': together.world,
    }
    if folder is not None and together.leads:
        write_json(folder / 'curves.json', {'epochs': curves})
    return Trained(replace(model, card=ModelCard(training)), curves, data)


def chosen_device(name: str) -> str:
    """Return `cuda` or `cpu` for `auto`, and other names as they are.

    Raises:
        TrainingError: A GPU is asked for, and there is none.
    """
    if name == 'auto':
        return usual_device()
    if name.startswith('cuda') and not torch.cuda.is_available():
        raise TrainingError(f'device {name} is asked for, but torch finds no GPU: use cpu or auto')
    return name


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
    processes = Processes.join()
    console = Console(quiet=not processes.leads, markup=False)
    # Small networks: more threads wait for each other longer than they help.
    torch.set_num_threads(1)
    if folder is None:
        digest = hashlib.blake2b(config.fingerprint().encode(), digest_size=4).hexdigest()
        folder = Path('runs') / f'train_{config.model}_{digest}'
    try:
        with Progress(console=console) as progress:
            bars: dict[str, TaskID] = {}

            def show(name: str, done: int, total: int, text: str) -> None:
                if name not in bars:
                    bars[name] = progress.add_task(name, total=total)
                progress.update(bars[name], completed=done, description=text)

            def report(
                stage: str, epoch: int, epochs: int, loss: float, error: float | None
            ) -> None:
                checked = '' if error is None else f', validation {error:.4f} N'
                show(stage, epoch, epochs, f'{stage}, loss {loss:.5f} N{checked}')

            trained = train_model(
                config,
                folder,
                jobs=jobs,
                report=report,
                on_progress=lambda done, total: show('preparing', done, total, 'preparing'),
                processes=processes,
            )
        if processes.leads:
            show_skipped(console, trained.data.skipped)
            _judge_and_write(console, config, trained, json)
    finally:
        processes.leave()


def _judge_and_write(
    console: Console, config: RunConfig, trained: Trained, json: Path | None
) -> None:
    """Write a model, judge it, and write it again with its figures."""
    # The weights first: training took its time, and not every model can be judged.
    save_model(Path(config.out), trained.model)
    metrics: dict[str, Any] = {}
    try:
        metrics = judge_trained(config, trained)
    except MixtacError as error:
        console.print(f'not judged: {error}', style='yellow', highlight=False)
    for title, figures in metrics.items():
        where = ', trials held back' if config.start else ''
        show_figures(console, title.replace('_', ' ') + where, figures)
    training = trained.model.card.training
    save_model(Path(config.out), replace(trained.model, card=ModelCard(training, metrics)))
    console.print(f'wrote {config.out}')
    content = {'model': config.out, 'run': asdict(config), 'training': training}
    write_json(json, content | {'metrics': metrics})


def judge_trained(config: RunConfig, trained: Trained) -> dict[str, Any]:
    """Return the figures of a model.

    Returns:
        Figures by profile: of an adapted model on the trials that were held back, `before` and
        `after`; of one that was trained on simulated trials on fresh days of sensors that were
        trained on, `seen_devices`, and on others, `unseen_devices`; else nothing.

    Raises:
        MixtacError: The model gives no estimate, or sees no press.
    """
    estimator, data = trial_estimator(trained.model), config.data.simulated
    if config.start:
        before = trial_estimator(read_model(find_model(config.start)))
        return {
            name: by_profile(judge_sources(each, trained.data.held).estimates)
            for name, each in (('before', before), ('after', estimator))
        }
    if data is None or config.judged < 1:
        return {}
    preset = data.presets[0]
    origins = [source.origin for source in trained.data.sources]
    # By another preset the same seed is another sensor; bags need not name either.
    known = sorted({each['device_seed'] for each in origins if each.get('preset') == preset})
    most = -(-config.judged // 2)
    seen = known[:: max(len(known) // most, 1)][:most]
    plan = {'seen_devices': (seen, 0), 'unseen_devices': (unseen_devices(config.judged, 0), 1)}
    return {
        name: judge_devices(estimator, devices, EVALUATION_SECONDS, seed, preset)[1]
        for name, (devices, seed) in plan.items()
        if devices
    }
