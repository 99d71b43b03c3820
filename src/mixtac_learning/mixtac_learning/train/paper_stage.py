# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Training of the paper's networks in stages: frames, changes of force, recurrent path, all.

The paper defines layers, epochs, batch size and learning rate. It does not define the start and the
length of a sequence, nor the training of each path. Here the frame network learns from single
frames first and the event path from changes of the force within short stretches. The recurrent path
then runs through whole trials from their beginning, without any true force.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn.functional import smooth_l1_loss
from torch.nn.modules.batchnorm import _BatchNorm

from mixtac_learning.network import usual_device
from mixtac_learning.paper.config import PaperConfig
from mixtac_learning.paper.layers import SAME, Scale
from mixtac_learning.paper.networks import (
    CYCLE_US,
    EventsOnly,
    FgerPaper,
    FrameModel,
    PaperNetwork,
    PaperState,
    build,
)
from mixtac_learning.paper.samples import (
    PaperSample,
    Segment,
    arrivals,
    assemble,
    frame_batch,
    run_samples,
)
from mixtac_learning.train.config import check_settings
from mixtac_learning.train.loop import Stage, TrainingLoop, share


@dataclass(frozen=True, slots=True)
class PaperTraining:
    """Settings of the training of one of the paper's networks.

    The paper's text alone (50 epochs, batches of 128, AdamW at 1e-4; section III-C) is
    `frame_epochs=0, event_epochs=0, recurrent_epochs=0, joint_epochs=50, joint_rate=1e-4,
    schedule='constant'`.

    Attributes:
        seed: Random seed for weights and order.
        frame_epochs: Epochs on single frames of the head, or of the correction of an estimate of
            zero; features do not learn.
        event_epochs: Epochs of the event path alone, of `event_updates` each, on changes of the
            force within stretches of `_STRETCH` windows that begin at the true force.
        recurrent_epochs: Epochs of the recurrent path on the same features of frames.
        joint_epochs: Epochs of the whole network; on single frames where there is no recurrence.
            None by default: features vary by some thousandths, and any step moves them by more.
        frame_batch: Frames per update.
        cycles: Frame intervals per update of the recurrent path: gradients do not reach further,
            the state does.
        group_trials: Trials side by side in an update of the recurrent path.
        event_batch: Stretches per update of the event path; the force changes in half of them.
        event_updates: Updates per epoch of the event path.
        frame_rate: Largest learning rate of the frame stage.
        event_rate: Largest learning rate of the stage of the event path.
        recurrent_rate: Largest learning rate of the recurrent stage.
        joint_rate: Largest learning rate of the joint stage.
        schedule: Of the learning rates; see `mixtac_learning.train.loop.schedule_factor`.
        weight_decay: AdamW's default.
        loss_knee_n: Errors above count linearly, below quadratically [N].
        force_weight: Additional weight of an error per newton of force [1/N].
        mixed: In bfloat16 on a CPU as well, which is faster where the processor knows it.
        patience: Epochs without a better validation error before a stage ends; the best weights
            are kept unless it is 0, for never.
    """

    seed: int = 0
    frame_epochs: int = 40
    event_epochs: int = 16
    recurrent_epochs: int = 12
    joint_epochs: int = 0
    frame_batch: int = 64
    cycles: int = 5
    group_trials: int = 64
    event_batch: int = 40
    event_updates: int = 50
    frame_rate: float = 3e-3
    event_rate: float = 2e-3
    recurrent_rate: float = 3e-4
    joint_rate: float = 1e-5
    schedule: str = 'cosine'
    weight_decay: float = 1e-2
    loss_knee_n: float = 0.05
    force_weight: float = 1.0
    mixed: bool = True
    patience: int = 50

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            ConfigError: One is too small.
        """
        least = {'frame_batch': 1, 'cycles': 1, 'group_trials': 1, 'event_batch': 2}
        check_settings(self, least)


@dataclass(eq=False)
class PaperStage(Stage):
    """What the stages of one network share.

    Attributes:
        network: The network.
        samples: Trials to train on.
        settings: The recipe.
        checked: Trials to validate on.
    """

    network: Any
    samples: Sequence[PaperSample]
    settings: PaperTraining
    checked: Sequence[PaperSample] = ()
    _kept: dict[Any, Any] = field(default_factory=dict)

    @property
    def device(self) -> torch.device:
        """Where the weights are."""
        return torch.device(next(self.network.parameters()).device)

    @property
    def frozen(self) -> tuple[str, ...]:
        """Names of the parts of the network that do not learn in this stage."""
        parts = {
            'frames': ('frame', 'events', 'recurrence'),
            'events': ('frame', 'correction'),
            'recurrent': ('frame',),
        }
        return parts.get(self.name, ())

    def parameters(self) -> list[nn.Parameter]:
        """Freeze some parts of the network and return the weights of the others."""
        for name, part in self.network.named_children():
            part.requires_grad_(name not in self.frozen)
        # Consecutive frames and windows are alike, unlike those that are drawn at random.
        for name, module in self.network.named_modules():
            if isinstance(module, Scale) and not name.endswith('input_scale'):
                random = not isinstance(self, RecurrentStage)
                module.follows = random and name.partition('.')[0] not in self.frozen
        return [each for each in self.network.parameters() if each.requires_grad]

    def validate(self) -> float | None:
        """Return the mean absolute error on the trials to validate on [N]."""
        if not self.checked:
            return None
        pairs = zip(self.checked, run_samples(self.network, self.checked), strict=True)
        total = sum(float(abs(force - sample.force).sum()) for sample, force in pairs)
        return total / sum(len(sample.force) for sample in self.checked)

    @contextmanager
    def plainly(self) -> Iterator[None]:
        """Compute features that do not learn as in use, and in full precision.

        They vary by no more than bfloat16 resolves.
        """
        training = self.network.training
        self.network.eval()
        with torch.autocast(self.device.type, enabled=False):
            yield
        self.network.train(training)

    def loss(self, force: Tensor, known: Tensor) -> Tensor:
        """Return the weighted loss of forces of any shape."""
        errors = smooth_l1_loss(force, known, beta=self.settings.loss_knee_n, reduction='none')
        weights = 1.0 + self.settings.force_weight * known.abs()
        return (weights * errors).sum() / weights.sum()


class FrameStage(PaperStage):
    """Single frames in random order; features that do not learn are computed once."""

    def updates(self) -> int:
        """Return the number of updates per epoch."""
        return max(len(arrivals(self.samples)) // self.settings.frame_batch, 1)

    def losses(self, random: torch.Generator) -> Iterator[Tensor]:
        """Yield the losses of one epoch."""
        network, found = self.network, arrivals(self.samples)
        order = torch.randperm(len(found), generator=random)
        for chosen in torch.split(order, self.settings.frame_batch)[: self.updates()]:
            if 'frame' in self.frozen:
                features, labels = (part[chosen] for part in self._encoded(self.samples))
            else:
                features, labels = self._features(self.samples, found[chosen.numpy()])
            yield self.loss(network.force_of(features), labels)

    def validate(self) -> float | None:
        """Return the mean absolute error at the frames of the trials to validate on [N]."""
        if isinstance(self.network, FgerPaper):
            self.network.begin_at_frames()
        if 'frame' not in self.frozen:
            # Constants that follow are some updates late, which features that vary by thousandths
            # of their mean do not bear.
            fit_frame_scales(self.network, self.samples)
        if not self.checked:
            return None
        features, known = self._encoded(self.checked)
        return float((self.network.force_of(features) - known).abs().mean())

    def _features(
        self, samples: Sequence[PaperSample], chosen: NDArray[np.int64]
    ) -> tuple[Tensor, Tensor]:
        """Return features and labels of frames, sorted by trial."""
        batch = frame_batch(samples, chosen, self.network.config)
        frames, event_frames, known = (part.to(self.device) for part in batch)
        return self.network.features(frames, event_frames), known

    @torch.no_grad()
    def _encoded(self, samples: Sequence[PaperSample]) -> tuple[Tensor, Tensor]:
        """Return features and labels of all frames; kept while the features do not learn."""
        key = samples is self.checked
        if key not in self._kept or 'frame' not in self.frozen:
            found = arrivals(samples)
            starts = range(0, len(found), _ENCODED)
            with self.plainly():
                parts = [self._features(samples, found[at : at + _ENCODED]) for at in starts]
            self._kept[key] = tuple(torch.cat(each) for each in zip(*parts, strict=True))
        features, labels = self._kept[key]
        return features, labels


_ENCODED = 256
_STRETCH = 25
"""Windows of a stretch of the event stage."""
_MOVES_N = 0.02
"""The force of a stretch counts as changing above this change [N]."""


class EventStage(PaperStage):
    """The event path on changes of the force, each from the true force and an empty memory."""

    def updates(self) -> int:
        """Return the number of updates per epoch."""
        return self.settings.event_updates

    def losses(self, random: torch.Generator) -> Iterator[Tensor]:
        """Yield the losses of one epoch."""
        moving = _moving(self.samples)
        longest = [len(sample.force) - _STRETCH for sample in self.samples]
        for _ in range(self.settings.event_updates):
            half = self.settings.event_batch // 2
            drawn = torch.randint(len(moving), (half,), generator=random).tolist()
            chosen = [moving[index] for index in drawn]
            for trial in torch.randint(len(longest), (half,), generator=random).tolist():
                start = int(torch.randint(1, longest[trial], (1,), generator=random))
                chosen.append(Segment(trial, start, start + _STRETCH))
            force, known = run_stretches(self.network, self.samples, chosen)
            yield self.loss(force, known)

    def validate(self) -> float | None:
        """Return the mean absolute error of the change within stretches of changing force [N]."""
        if not self.checked:
            return None
        moving = _moving(self.checked)
        with torch.no_grad():
            some = moving[:: -(-len(moving) // _ENCODED)]
            force, known = run_stretches(self.network, self.checked, some)
        return float((force[-1] - known[-1]).abs().mean())


def _moving(samples: Sequence[PaperSample]) -> list[Segment]:
    """Return stretches in which the force changes; all stretches where it never does."""
    every, found = [], []
    for trial, sample in enumerate(samples):
        for start in range(1, len(sample.force) - _STRETCH, _STRETCH // 5):
            every.append(Segment(trial, start, start + _STRETCH))
            if abs(sample.force[start + _STRETCH - 1] - sample.force[start]) > _MOVES_N:
                found.append(every[-1])
    return found or every


def run_stretches(
    network: Any,  # noqa: ANN401 - one of two classes with a recurrence
    samples: Sequence[PaperSample],
    chosen: Sequence[Segment],
) -> tuple[Tensor, Tensor]:
    """Run the event path alone through stretches, from the true force and an empty memory.

    Args:
        network: With a recurrence.
        samples: Trials.
        chosen: Stretches of equal length; none begins with the first window of its trial.

    Returns:
        Estimated and true force [N], float32 [windows, stretches].
    """
    state = network.initial_state(len(chosen))
    device = state.force.device
    batch = assemble(samples, chosen, replace(network.config, model='events')).to(device)
    before = [float(samples[s.trial].force[s.start - 1]) for s in chosen]
    state = state._replace(force=torch.tensor(before, device=device))
    return network.recurrence(batch, state)[0], batch.force


class RecurrentStage(PaperStage):
    """Truncated back-propagation through whole trials side by side, the state carried along."""

    def updates(self) -> int:
        """Return the usual number of updates per epoch."""
        return sum(-(-len(self.samples[g[0]].force) // self._windows) for g in self._groups())

    def losses(self, random: torch.Generator) -> Iterator[Tensor]:
        """Yield the losses of one epoch, group by group in random order."""
        groups, left = self._groups(), self.updates()
        config = self.network.config
        for number in torch.randperm(len(groups), generator=random).tolist():
            group, features = groups[number], self._features()
            state = self.network.initial_state(len(group))
            start, longest = 0, len(self.samples[group[0]].force)
            # The first stretch has any length, so that borders differ from epoch to epoch.
            stop = int(torch.randint(1, self._windows + 1, (1,), generator=random))
            while start < longest and left:
                stop = min(stop, longest)
                # Trials that have ended leave; the longest come first.
                active = [trial for trial in group if len(self.samples[trial].force) >= stop]
                segments = [Segment(trial, start, stop) for trial in active]
                batch = assemble(self.samples, segments, config, features)
                kept = PaperState(*(part[: len(active)] for part in state))
                force, state = self.network(batch.to(self.device), kept)
                state = PaperState(*(part.detach() for part in state))
                yield self.loss(force, batch.force.to(self.device))
                start, stop, left = stop, stop + self._windows, left - 1

    @torch.no_grad()
    def _features(self) -> list[NDArray[np.float32]]:
        """Return f_frame of all frames by trial, where the frame network does not learn."""
        if not isinstance(self.network, FgerPaper) or not self.frozen:
            return []
        for trial, sample in enumerate(self.samples if not self._kept else ()):
            seen = sample.seen(np.arange(len(sample.frames)), self.network.config)
            frames = torch.from_numpy(seen).to(self.device)
            with self.plainly():
                parts = [self.network.frame(part) for part in torch.split(frames, _ENCODED)]
            self._kept[trial] = np.asarray(torch.cat(parts).cpu().numpy(), np.float32)
        return list(self._kept.values())

    @property
    def _windows(self) -> int:
        return int(self.settings.cycles * (CYCLE_US // self.network.config.window_us))

    def _groups(self) -> list[list[int]]:
        """Return trials that run side by side, the longest first."""
        order = sorted(range(len(self.samples)), key=lambda k: -len(self.samples[k].force))
        size = self.settings.group_trials
        return [order[first : first + size] for first in range(0, len(order), size)]


@torch.no_grad()
def fit_scales(network: PaperNetwork, samples: Sequence[PaperSample]) -> None:
    """Set the scales of fresh weights to the mean and spread over some windows of the trials."""
    config, device = network.config, next(network.parameters()).device
    chosen = _some(samples)
    norms = [each for each in network.modules() if isinstance(each, _BatchNorm)]
    for norm in norms:
        norm.momentum = 1.0  # the statistics of these frames
    if not isinstance(network, EventsOnly):
        frames = frame_batch(samples, chosen, config).frames.to(device)
        network.frame.input_scale.fit(network.frame.seen(frames).flatten(0, 2))
        fit_frame_scales(network, samples)
    if not isinstance(network, FrameModel):
        segments = [Segment(trial, window, window + 1) for trial, window in chosen.tolist()]
        batch = assemble(samples, segments, replace(config, model='events')).to(device)
        network.recurrence.encoder.scale.fit(network.recurrence.features(batch)[0])
        changes = np.concatenate([np.diff(sample.force) for sample in samples])
        network.recurrence.unit.fill_(max(float(changes.std()), SAME))
    for norm in norms:
        norm.momentum = 0.1


@torch.no_grad()
def fit_frame_scales(network: PaperNetwork, samples: Sequence[PaperSample]) -> None:
    """Set the scales of the features of frames to their mean and spread over some frames."""
    if isinstance(network, EventsOnly):
        return
    device = next(network.parameters()).device
    batch = frame_batch(samples, _some(samples), network.config)
    parts: list[tuple[Any, Tensor]] = [(network.frame, batch.frames)]
    if network.config.model == 'fusion':
        parts.append((network.events, batch.event_frames))
    for part, inputs in parts:
        part.scale.reset()
        part.scale.fit(part(inputs.to(device)))


def _some(samples: Sequence[PaperSample]) -> NDArray[np.int64]:
    found = arrivals(samples)
    return found[:: -(-len(found) // _FITTED)]


_FITTED = 256
"""Frames or windows that scales are fitted to."""


def train_paper(
    config: PaperConfig,
    settings: PaperTraining,
    samples: Sequence[PaperSample],
    checked: Sequence[PaperSample],
    **options: Any,  # noqa: ANN401
) -> tuple[PaperNetwork, list[dict[str, Any]]]:
    """Train one network and return it, on the CPU in evaluation mode, and the curves.

    The scales of inputs and features are set to those of the training trials (`fit_scales`).

    Args:
        config: Shapes.
        settings: The recipe.
        samples: Trials to train on.
        checked: Trials to validate on.
        options: Of `TrainingLoop`: checkpoint, fingerprint and show.

    Raises:
        TrainingError: As `TrainingLoop.run`, or there are fewer trials than processes.
    """
    torch.manual_seed(settings.seed)
    network = build(config)
    network.to(usual_device())
    fit_scales(network, samples)
    own = share(samples)
    loop = TrainingLoop(
        network,
        seed=settings.seed,
        weight_decay=settings.weight_decay,
        schedule=settings.schedule,
        patience=settings.patience,
        mixed=settings.mixed,
        **options,
    )
    plan: list[tuple[type[PaperStage], str, int, float]] = []
    if not isinstance(network, EventsOnly):
        plan.append((FrameStage, 'frames', settings.frame_epochs, settings.frame_rate))
    if isinstance(network, FrameModel):
        plan.append((FrameStage, 'joint', settings.joint_epochs, settings.joint_rate))
    else:
        plan += [
            (EventStage, 'events', settings.event_epochs, settings.event_rate),
            (RecurrentStage, 'recurrent', settings.recurrent_epochs, settings.recurrent_rate),
            (RecurrentStage, 'joint', settings.joint_epochs, settings.joint_rate),
        ]
    stages = [
        kind(name, epochs, rate, network, own, settings, checked)
        for kind, name, epochs, rate in plan
        if epochs
    ]
    loop.run(stages)
    return network.cpu().eval(), loop.progress.curves
