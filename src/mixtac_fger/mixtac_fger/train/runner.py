# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Carrying a training run out: samples, loop, weight file, model card, curves."""

from __future__ import annotations

import hashlib
import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import torch

from mixtac_fger.config import FgerConfig
from mixtac_fger.errors import TrainingError
from mixtac_fger.paper.config import PaperConfig
from mixtac_fger.paper.models import build
from mixtac_fger.paper.samples import PaperRecipe, load_paper_sample
from mixtac_fger.paper.stage import PaperStage, PaperTraining, fit_intensities
from mixtac_fger.paper.weights import save_paper_model
from mixtac_fger.train.curves import write_curves
from mixtac_fger.train.data import TrainingData, gather
from mixtac_fger.train.loop import LoopSettings, TrainingLoop
from mixtac_fger.train.model_card import write_model_card
from mixtac_fger.train.parallel import Processes
from mixtac_fger.train.provenance import provenance
from mixtac_fger.train.run_config import OURS
from mixtac_fger.train.sequence_groups import DiskGroups
from mixtac_fger.training import Trainer
from mixtac_fger.training_settings import TrainingSettings
from mixtac_fger.trials.fger_recipe import FgerRecipe
from mixtac_fger.weights import LoadedModel, ModelCard, save_model

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from mixtac_fger.paper.models import PaperNetwork
    from mixtac_fger.train.loop import Report
    from mixtac_fger.train.run_config import RunConfig

CHECKPOINT = 'checkpoint.safetensors'


@dataclass(frozen=True, slots=True, eq=False)
class Trained:
    """What a run gave.

    Attributes:
        network: In evaluation mode, on the CPU.
        card: What its weight file says.
        curves: One row per epoch.
        skipped: Trials that were left out, with the reason.
    """

    network: Any
    card: ModelCard
    curves: list[dict[str, Any]]
    skipped: dict[str, str]


@dataclass(slots=True, eq=False)
class Run:
    """A training run.

    Attributes:
        config: What to train on what.
        folder: Checkpoint and curves; None keeps nothing, so that a killed run starts over.
        jobs: Processes that prepare samples.
        report: Called after each epoch.
        on_progress: Called while samples are prepared, with the number done and of all.
        processes: Who takes part.
    """

    config: RunConfig
    folder: Path | None = None
    jobs: int = 1
    report: Report = lambda *_: None
    on_progress: Callable[[int, int], None] = lambda _done, _total: None
    processes: Processes = field(default_factory=Processes)

    def carry_out(self) -> Trained:
        """Train, and write curves; the weight file is the caller's (`save`).

        Raises:
            ConfigError: A setting is unknown or impossible.
            DatasetError: No trial can be used.
            TrainingError: The folder is another run's, or training fails.
        """
        started = time.monotonic()
        run = self._ours if self.config.model == OURS else self._paper
        network, curves, data, settings = run()
        training = provenance(self.config, data, settings) | {
            'minutes': round((time.monotonic() - started) / 60, 1),
            'processes': self.processes.world,
        }
        if self.folder is not None and self.processes.leads:
            write_curves(self.folder, curves)
        return Trained(network, ModelCard(training), curves, data.skipped)

    def _gather(self, recipe: FgerRecipe | PaperRecipe) -> TrainingData:
        # One process prepares, the others find the files.
        if self.processes.leads:
            gather(self.config.data, recipe, self.jobs, self.on_progress)
        self.processes.wait()
        return gather(self.config.data, recipe)

    def _ours(self) -> tuple[Any, list[dict[str, Any]], TrainingData, dict[str, Any]]:
        config = FgerConfig.from_dict(FgerConfig().to_dict() | self.config.network)
        settings = TrainingSettings.from_dict(self.config.training)
        data = self._gather(FgerRecipe(config, self.config.data.label))
        own = self.processes.share(range(len(data.trained)))
        groups = DiskGroups(data.trained, config, settings.group_trials, own)
        held = DiskGroups(data.checked, config, settings.group_trials) if data.checked else None
        trainer = Trainer(
            config,
            settings,
            self.report,
            processes=self.processes,
            device=chosen_device(self.config.device),
            checkpoint=self._checkpoint(),
            fingerprint=self._fingerprint(data),
        )
        network = trainer.run(groups, held)
        return network, trainer.curves, data, settings.to_dict()

    def _paper(self) -> tuple[Any, list[dict[str, Any]], TrainingData, dict[str, Any]]:
        config = PaperConfig.from_dict({'model': self.config.model} | self.config.network)
        settings = PaperTraining.from_dict(self.config.training)
        data = self._gather(PaperRecipe(config, self.config.data.label))
        samples = [load_paper_sample(path) for path in data.trained]
        checked = [load_paper_sample(path) for path in data.checked]
        torch.manual_seed(settings.seed)
        network: PaperNetwork = build(config)
        fit_intensities(network, samples)
        network.to(chosen_device(self.config.device))
        own = self.processes.share(range(len(samples)))
        if not own:
            raise TrainingError(f'{len(samples)} trials for {self.processes.world} processes')
        stage = PaperStage(network, samples, settings, self.processes, own, checked)
        loop = TrainingLoop(
            network,
            LoopSettings(
                settings.seed, settings.weight_decay, 'constant', patience=settings.patience
            ),
            self._checkpoint(),
            self._fingerprint(data),
            self.report,
            self.processes,
        )
        loop.run([stage])
        return network.cpu().eval(), loop.progress.curves, data, settings.to_dict()

    def _checkpoint(self) -> Path | None:
        return None if self.folder is None else self.folder / CHECKPOINT

    def _fingerprint(self, data: TrainingData) -> str:
        """Return a digest of settings, data and number of processes."""
        names = [path.name for path in (*data.trained, *data.checked)]
        text = f'{self.config.fingerprint()} {names} {self.processes.world}'
        return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def save(path: Path, trained: Trained, metrics: dict[str, Any]) -> None:
    """Write the weight file of a run and its model card, a text file of the same name.

    Args:
        path: File; its suffix is `.safetensors`.
        trained: The run.
        metrics: Figures on trials that were not trained on.
    """
    card = ModelCard(trained.card.training, metrics)
    if trained.card.training['model'] == OURS:
        save_model(path, trained.network, card)
    else:
        save_paper_model(path, trained.network, card)
    write_model_card(path.with_suffix('.md'), path.name, card)


def loaded(trained: Trained) -> LoadedModel:
    """Return a run of our network as the model that is judged."""
    return LoadedModel(trained.network, trained.card)


def chosen_device(name: str) -> str:
    """Return `cuda` or `cpu` for `auto`, and other names as they are.

    Raises:
        TrainingError: A GPU is asked for, and there is none.
    """
    if name == 'auto':
        return 'cuda' if torch.cuda.is_available() else 'cpu'
    if name.startswith('cuda') and not torch.cuda.is_available():
        raise TrainingError(f'device {name} is asked for, but torch finds no GPU: use cpu or auto')
    return name
