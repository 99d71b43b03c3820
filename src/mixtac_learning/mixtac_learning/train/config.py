# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A training run as a YAML file describes it: model, data, stages, learning rates."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from mixtac_core.node.files import FileError, read_dataclass, share
from mixtac_core.node.topics import REFERENCE
from mixtac_fger.config import ConfigError
from mixtac_learning.paper.config import MODELS as PAPER_MODELS
from mixtac_sim.world.plans import TRAINING_PRESET


def check_settings(settings: Any, counts: Mapping[str, int]) -> None:  # noqa: ANN401
    """Check the numbers of training settings.

    Args:
        settings: A dataclass.
        counts: Least values of some fields; no number is below 0.

    Raises:
        ConfigError: A number is smaller.
    """
    for name, value in dataclasses.asdict(settings).items():
        least = counts.get(name, 0)
        if isinstance(value, (int, float)) and not value >= least:
            raise ConfigError(f'training.{name} = {value}', remedy=f'give {least} or more')


@dataclass(frozen=True, slots=True)
class TrainingSettings:
    """Settings of a training run; with its seed and data they fix the result.

    Attributes:
        seed: Random seed for initial weights, order and mirroring of the data.
        recurrent_epochs: Epochs of the recurrent path.
        chunk_windows: Windows per update: gradients do not reach further.
        recurrent_rate: Largest learning rate.
        weight_decay: Weight decay of AdamW.
        loss_knee_n: Errors above this count linearly, below it quadratically [N]; a fifth of it
            near no force (`mixtac_learning.train.sequences.force_loss`).
        mirror: Show mirror images too.
        force_weight: Additional weight of an error per newton of force [1/N], because impacts are
            short.
        blow_every: Number of updates between updates on impacts only, cut out of the trials
            (`mixtac_learning.train.stages`); 0 for none.
        group_trials: Trials in memory at a time.
        patience: Epochs without a better validation error after which a stage ends; 0 for never.
    """

    seed: int = 0
    recurrent_epochs: int = 60
    chunk_windows: int = 100
    recurrent_rate: float = 3e-3
    weight_decay: float = 1e-3
    loss_knee_n: float = 0.05
    mirror: bool = True
    force_weight: float = 0.0
    blow_every: int = 0
    group_trials: int = 128
    patience: int = 0

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            ConfigError: One is too small.
        """
        check_settings(self, {'chunk_windows': 1, 'group_trials': 1})


OURS = 'ours'
MODELS = (OURS, *PAPER_MODELS)
_REMEDY = 'see the shipped files in config/train'


@dataclass(frozen=True, slots=True)
class SimulatedData:
    """Trials that are simulated for the run.

    Attributes:
        presets: Difficulty of the sensors, in turn; the model is judged at the first.
        sensors: Different sensors.
        trials: Trials, going round the sensors.
        seconds: Length of each.
        profiles: Force profiles, in turn; empty for those of `mixtac_sim.world.plans`.
        seed: Another seed gives other sensors and days.
        session: Trials of one session of one sensor instead of those above: number and length [s]
            by profile; `mixtac_sim.world.plans.session_plan` keeps a fifth for testing.
    """

    presets: tuple[str, ...] = (TRAINING_PRESET,)
    sensors: int = 1
    trials: int = 24
    seconds: float = 8.0
    profiles: tuple[str, ...] = ()
    seed: int = 0
    session: dict[str, tuple[int, float]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class DataConfig:
    """What to train on.

    Attributes:
        simulated: Simulated trials; None for none.
        bags: Bags, or folders of bags; of bags that `dataset.yaml` describes only the training
            split is used.
        reference: Topic of the reference force in bags.
        cache: Folder of prepared samples.
        checked: Part of the sensors, or of the trials where sensors are few, that is held out to
            validate on.
    """

    simulated: SimulatedData | None = None
    bags: tuple[str, ...] = ()
    reference: str = REFERENCE
    cache: str = 'runs/fger_data'
    checked: float = 0.1


@dataclass(frozen=True, slots=True)
class RunConfig:
    """A training run.

    Attributes:
        model: One of `MODELS`.
        out: Weight file to write.
        network: Fields of the network's configuration that differ from its defaults.
        training: Fields of the training settings that differ from their defaults.
        data: What to train on.
        judged: Simulated sensors that no training used, on which the model is judged afterwards;
            0 judges nothing.
        start: Weight file of `ours` to adapt, or name of a shipped model: the network is that of
            the file. Empty for random weights.
    """

    model: str = OURS
    out: str = 'models/fger_small.safetensors'
    network: dict[str, Any] = field(default_factory=dict)
    training: dict[str, Any] = field(default_factory=dict)
    data: DataConfig = field(default_factory=DataConfig)
    judged: int = 6
    start: str = ''

    def __post_init__(self) -> None:
        """Check what can be checked without the data.

        Raises:
            ConfigError: Unknown model, a model that cannot be adapted, or nothing to train on.
        """
        if self.model not in MODELS:
            raise ConfigError(f'model {self.model!r} is unknown: choose one of {", ".join(MODELS)}')
        if self.start and self.model != OURS:
            raise ConfigError(
                f'{self.model} cannot start from {self.start}', remedy='start the model ours only'
            )
        if self.data.simulated is None and not self.data.bags:
            raise ConfigError(
                'nothing to train on: neither data.simulated nor data.bags is given', remedy=_REMEDY
            )

    def fingerprint(self) -> str:
        """Return a text of all that changes the result; not where it is written."""
        fields = dataclasses.asdict(self)
        for name in ('out', 'judged'):
            fields.pop(name)
        fields['data'].pop('cache')
        return json.dumps(fields, sort_keys=True)


def read_run_config(name: str) -> RunConfig:
    """Read a run from a YAML file: a path, or the name of a shipped one without `.yaml`.

    Raises:
        ConfigError: The file is missing or no YAML, or a field is unknown or of another type.
    """
    path = Path(name).expanduser()
    if path.suffix not in {'.yaml', '.yml'} and not path.exists():
        path = shipped_runs() / f'{name}.yaml'
    try:
        return read_dataclass(path, RunConfig)
    except FileError as error:
        raise ConfigError(error.message, remedy=_REMEDY) from error


ADAPTING = {
    'recurrent_epochs': 10,
    'recurrent_rate': 3e-4,
}
"""Training settings of `--start`: small steps, from weights that are good already."""
HELD_BACK = 0.2
"""Part of the trials that `--start` holds back."""


def with_overrides(
    config: RunConfig,
    out: Path | None = None,
    seed: int | None = None,
    data: Path | None = None,
    bags: Sequence[Path] = (),
    start: str | None = None,
) -> RunConfig:
    """Return a run with the values of the command line instead of those of the file.

    Args:
        config: The run.
        out: Weight file to write.
        seed: Random seed.
        data: Folder of prepared samples.
        bags: Bags, or folders of bags, in place of all data of the file.
        start: Weight file or shipped model to adapt, with the settings `ADAPTING`.

    Raises:
        ConfigError: The model cannot be adapted.
    """
    training, changed = dict(config.training), dict[str, Any]()
    target = out or config.out
    if bags:
        changed |= {'simulated': None, 'bags': tuple(str(bag) for bag in bags)}
    if start is not None:
        config = replace(config, start=start)
        training |= ADAPTING
        changed['checked'] = HELD_BACK
        target = out or f'models/{Path(start).stem}_adapted.safetensors'
    if seed is not None:
        training['seed'] = seed
    if data is not None:
        changed['cache'] = str(data)
    chosen = replace(config.data, **changed)
    return replace(config, out=str(target), training=training, data=chosen)


def shipped_runs() -> Path:
    """Return the folder of the runs that come with the package."""
    return share('mixtac_bringup') / 'config' / 'train'
