# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The training loop: stages of epochs, learning-rate schedule, early stopping, checkpoints.

A checkpoint is one safetensors file with the weights, the best weights so far, the moments of the
optimiser and the state of the random generators. It is replaced only when the new one is complete,
so a killed run always leaves a whole file to resume from.
"""

from __future__ import annotations

import json
import math
import os
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import KW_ONLY, asdict, dataclass, field
from datetime import timedelta
from pathlib import Path
from typing import Any, TypeVar

import torch
import torch.distributed as dist
from torch import Tensor, nn

from mixtac_core.events.errors import MixtacError
from mixtac_fger.weights import read_tensors, write_tensors

T = TypeVar('T')
PATIENCE = timedelta(days=7)
"""How long processes wait for the one that prepares the data; by default it is half an hour."""


def join_processes() -> None:
    """Join the processes that `torchrun` started; without it there is only this one."""
    if int(os.environ.get('WORLD_SIZE', '1')) > 1:
        dist.init_process_group('gloo', timeout=PATIENCE)


def leave_processes() -> None:
    """Leave the other processes, all at once; after an error, torchrun ends them."""
    wait()
    if dist.is_initialized():
        dist.destroy_process_group()


def rank() -> int:
    """Return the number of this process, from 0; only 0 writes files and prints."""
    return dist.get_rank() if dist.is_initialized() else 0


def world() -> int:
    """Return the number of processes that share the training."""
    return dist.get_world_size() if dist.is_initialized() else 1


def wait() -> None:
    """Wait for all processes."""
    if dist.is_initialized():
        dist.barrier()


def share(items: Sequence[T]) -> list[T]:
    """Return this process's part of a sequence, of nearly equal size.

    Raises:
        TrainingError: There are fewer items than processes: all of them refuse alike.
    """
    if len(items) >= world():
        return list(items[rank() :: world()])
    trials = f'{len(items)} trials are too few for {world()} processes'
    raise TrainingError(trials, remedy='start fewer processes, or give more trials')


def mean(tensor: Tensor) -> Tensor:
    """Return the mean of a tensor over all processes."""
    if world() == 1:
        return tensor
    total = tensor.detach().cpu().clone()
    dist.all_reduce(total)
    return (total / world()).to(tensor.device)


def smallest(number: int) -> int:
    """Return the smallest of all processes' numbers."""
    value = torch.tensor(number)
    if world() > 1:
        dist.all_reduce(value, dist.ReduceOp.MIN)
    return int(value)


def average_gradients(parameters: Sequence[nn.Parameter]) -> None:
    """Average the gradients over all processes; a missing one counts as zero."""
    for each in parameters if world() > 1 else ():
        each.grad = mean(torch.zeros_like(each) if each.grad is None else each.grad)


@torch.no_grad()
def average_weights(module: nn.Module) -> None:
    """Give all processes the mean of all weights and statistics."""
    for each in module.state_dict().values() if world() > 1 else ():
        if each.is_floating_point():
            each.copy_(mean(each))


Show = Callable[[str, int, int, str], None]
"""Shows progress: name of the task, how much of it is done, of how much, and a text."""


class TrainingError(MixtacError):
    """A training run that cannot start or continue."""


_WARM = 0.05
_LAST = 0.02


def schedule_factor(name: str, part: float) -> float:
    """Return the factor of the learning rate.

    Args:
        name: `cosine`: up within the first 5 %, then down to 2 % along a cosine; `constant`.
        part: Part of the stage that is done, 0 to 1.

    Raises:
        TrainingError: Unknown name.
    """
    if name == 'constant':
        return 1.0
    if name != 'cosine':
        raise TrainingError(f'schedule {name!r} is unknown: choose cosine or constant')
    if part < _WARM:
        return _LAST + (1.0 - _LAST) * part / _WARM
    phase = min((part - _WARM) / (1.0 - _WARM), 1.0)
    return _LAST + 0.5 * (1.0 - _LAST) * (1.0 + math.cos(math.pi * phase))


@dataclass(slots=True)
class Progress:
    """How far a run is.

    Attributes:
        stage: Index of the present stage.
        epoch: Epochs of it that are done.
        best: Smallest validation error of the stage; None before the first.
        since_best: Epochs since then.
        curves: One row per epoch: stage, epoch, loss, validation error, and how long it took:
            seconds, and core_seconds of the processor.
    """

    stage: int = 0
    epoch: int = 0
    best: float | None = None
    since_best: int = 0
    curves: list[dict[str, Any]] = field(default_factory=list)


Parts = dict[str, dict[str, Tensor]]
"""Tensors of a checkpoint by part (`model`, `best`, `optimiser`, `random`) and name."""


def load_checkpoint(path: Path, fingerprint: str) -> tuple[Progress, Parts] | None:
    """Return progress and tensors of a checkpoint, None where there is none.

    Args:
        path: File.
        fingerprint: Fingerprint of the run to be resumed.

    Raises:
        TrainingError: It belongs to a run with other settings or data, or cannot be read.
    """
    if not path.exists():
        return None
    header, arrays = read_tensors(path, TrainingError, 'remove it to start over')
    parts: Parts = {'best': {}, 'optimiser': {}, 'random': {}}
    for name, array in arrays.items():
        part, _, rest = name.partition('.')
        parts.setdefault(part, {})[rest] = torch.from_numpy(array)
    if header.get('fingerprint') != fingerprint:
        raise TrainingError(
            f'{path} belongs to a run with other settings or data',
            remedy='give another folder with --folder, or remove it to start over',
        )
    return Progress(**json.loads(header['progress'])), parts


def save_checkpoint(path: Path, fingerprint: str, progress: Progress, parts: Parts) -> None:
    """Write a checkpoint."""
    header = {'fingerprint': fingerprint, 'progress': json.dumps(asdict(progress))}
    arrays = {
        f'{part}.{name}': value.detach().cpu().numpy()
        for part, tensors in parts.items()
        for name, value in tensors.items()
    }
    write_tensors(path, arrays, header)


@dataclass(eq=False)
class Stage(ABC):
    """A part of training with an optimiser of its own.

    Attributes:
        name: Name of the stage.
        epochs: Most epochs of the stage.
        rate: Largest learning rate.
    """

    name: str
    epochs: int
    rate: float

    def begin(self) -> None:  # noqa: B027 - most stages begin with the weights as they are
        """Set weights before the first epoch; not called when resumed within the stage."""

    @abstractmethod
    def parameters(self) -> list[nn.Parameter]:
        """Return what is trained."""

    @abstractmethod
    def updates(self) -> int:
        """Return the usual number of updates per epoch, for the schedule."""

    @abstractmethod
    def losses(self, random: torch.Generator) -> Iterator[Tensor]:
        """Yield the losses of one epoch; the update is made before the next is asked for.

        Processes make equally many updates: the epoch of all ends with the first that has no more.
        """

    def validate(self) -> float | None:
        """Return the error on trials that are not trained on [N]; None without such trials."""
        return None


def _restore(optimiser: torch.optim.Optimizer, stored: dict[str, Tensor]) -> None:
    """Give an optimiser its moments back."""
    moments: dict[int, dict[str, Tensor]] = {}
    for name, value in stored.items():
        index, _, kind = name.partition('.')
        moments.setdefault(int(index), {})[kind] = value
    optimiser.load_state_dict(optimiser.state_dict() | {'state': moments})


GRADIENT_NORM = 1.0
"""Gradients are scaled down to this norm."""


@dataclass(slots=True, eq=False)
class TrainingLoop:
    """Runs stages, one after the other; on a GPU in bfloat16 where that is safe.

    Attributes:
        module: Everything that is trained: what a checkpoint holds.
        seed: Random seed for the order of the data; initial weights are the caller's.
        weight_decay: Weight decay of AdamW.
        schedule: Schedule of the learning rate; see `schedule_factor`.
        patience: A stage ends after so many epochs without a better validation error and goes
            back to its best weights, be it those that it began with; 0 for never.
        checkpoint: File of the checkpoint; None for none.
        fingerprint: Identifies the run; a checkpoint of another run is refused.
        show: Called after each epoch.
        mixed: In bfloat16 on a CPU as well.
        progress: Progress of the run.
    """

    module: nn.Module
    _: KW_ONLY
    seed: int = 0
    weight_decay: float = 1e-3
    schedule: str = 'cosine'
    patience: int = 0
    checkpoint: Path | None = None
    fingerprint: str = ''
    show: Show = lambda *_: None
    mixed: bool = False
    progress: Progress = field(default_factory=Progress)

    def run(self, stages: Sequence[Stage]) -> None:
        """Run all stages; stages that are done according to the checkpoint are skipped.

        Raises:
            TrainingError: The checkpoint is another run's, or the loss became NaN.
        """
        found = load_checkpoint(self.checkpoint, self.fingerprint) if self.checkpoint else None
        random = torch.Generator().manual_seed(self.seed)
        if found is not None:
            self.progress, parts = found
            self.module.load_state_dict(parts['model'])
            random.set_state(parts['random']['stages'])
            torch.set_rng_state(parts['random']['global'])
        for stage in stages[self.progress.stage :]:
            self._run_stage(stage, random, found and found[1])
            found = None
            self.progress = Progress(self.progress.stage + 1, curves=self.progress.curves)

    def _run_stage(self, stage: Stage, random: torch.Generator, found: Parts | None) -> None:
        progress = self.progress
        if progress.epoch == 0:
            stage.begin()
            average_weights(self.module)
        optimiser = torch.optim.AdamW(
            stage.parameters(), lr=stage.rate, weight_decay=self.weight_decay
        )
        best: dict[str, Tensor] = {}
        if found is not None:
            _restore(optimiser, found['optimiser'])
            best = found['best']
        elif self.patience:
            # No stage ends with worse weights than it began with.
            progress.best = self._validate(stage)
            best = self._weights() if progress.best is not None else {}
        while progress.epoch < stage.epochs:
            if self.patience and progress.since_best >= self.patience:
                break
            started, busy = time.monotonic(), time.process_time()
            loss = self._epoch(stage, optimiser, random)
            error = self._validate(stage)
            average_weights(self.module)
            progress.epoch += 1
            if error is not None:
                progress.since_best += 1
                if progress.best is None or error < progress.best:
                    progress.best, progress.since_best = error, 0
                    best = self._weights()
            row = {'stage': stage.name, 'epoch': progress.epoch, 'loss': loss, 'validation': error}
            row['seconds'] = round(time.monotonic() - started, 2)
            row['core_seconds'] = round(time.process_time() - busy, 2)
            progress.curves.append(row)
            checked = '' if error is None else f', validation {error:.4f} N'
            text = f'{stage.name}, loss {loss:.5f} N{checked}'
            self.show(stage.name, progress.epoch, stage.epochs, text)
            if self.checkpoint is not None and rank() == 0:
                moments = optimiser.state_dict()['state']
                parts = {
                    'model': self.module.state_dict(),
                    'best': best,
                    'optimiser': {f'{i}.{k}': v for i, s in moments.items() for k, v in s.items()},
                    'random': {'stages': random.get_state(), 'global': torch.get_rng_state()},
                }
                save_checkpoint(self.checkpoint, self.fingerprint, progress, parts)
        if best and self.patience:
            self.module.load_state_dict(best)

    def _weights(self) -> dict[str, Tensor]:
        return {name: value.detach().clone() for name, value in self.module.state_dict().items()}

    def _epoch(
        self, stage: Stage, optimiser: torch.optim.Optimizer, random: torch.Generator
    ) -> float:
        """Make the updates of one epoch and return their mean loss."""
        self.module.train()
        (group,) = optimiser.param_groups
        parameters = group['params']
        updates = max(smallest(stage.updates()), 1)
        total, count = 0.0, 0
        device = parameters[0].device.type
        losses = stage.losses(random)
        while True:
            part = (self.progress.epoch + min(count / updates, 1.0)) / stage.epochs
            group['lr'] = stage.rate * schedule_factor(self.schedule, part)
            with torch.autocast(device, torch.bfloat16, enabled=self.mixed or device == 'cuda'):
                loss = next(losses, None)
            if not smallest(int(loss is not None)) or loss is None:
                break
            optimiser.zero_grad(set_to_none=True)
            loss.backward()  # type: ignore[no-untyped-call]
            average_gradients(parameters)
            torch.nn.utils.clip_grad_norm_(parameters, GRADIENT_NORM)
            optimiser.step()
            total, count = total + float(loss.detach()), count + 1
            if math.isnan(total):
                raise TrainingError(
                    f'the loss of stage {stage.name} became NaN', remedy='lower its learning rate'
                )
        return total / max(count, 1)

    @torch.no_grad()
    def _validate(self, stage: Stage) -> float | None:
        self.module.eval()
        error = stage.validate()
        return None if error is None else float(mean(torch.tensor(error)))
