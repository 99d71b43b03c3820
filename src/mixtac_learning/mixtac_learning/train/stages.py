# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Training FGER-Net in stages: frame network, recurrent path, both together, uncertainty head.

The uncertainty head learns from the errors of the finished network. Its likelihood is Laplacian, as
errors have heavy tails. Its scale is fitted afterwards on held-out trials, so that an interval of
one deviation to both sides covers as much as for a Gaussian. Errors within one trial are
correlated: n trials determine the scale like n independent draws, and a further trial spreads like
Student's t with n degrees of freedom. The gains of the sensors are not used here, because the error
caused by an unknown stiffness belongs to the uncertainty.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from mixtac_fger.config import FgerConfig
from mixtac_fger.fger_net import SPREAD_WINDOWS
from mixtac_fger.shear import ShearHead
from mixtac_learning.network import (
    Course,
    FgerNetwork,
    FrameSlots,
    SequenceState,
    arrays_of,
    usual_device,
)
from mixtac_learning.train.config import TrainingSettings
from mixtac_learning.train.frame_stage import (
    DiskGroups,
    FgerStage,
    Flip,
    FrameStage,
    NetworkWithGains,
    Sequences,
    draw_flips,
    encode,
    force_loss,
    frame_features,
    frame_parameters,
    mean_error,
    mirror_events,
    shuffled,
)
from mixtac_learning.train.loop import TrainingError, TrainingLoop, average_weights, mean


@torch.no_grad()
def estimate(network: FgerNetwork, sequences: Sequences) -> tuple[Tensor, Tensor]:
    """Run all sequences from their start.

    Returns:
        Force at the end of each window [T, B] and frames-only force of each frame [N], in N.
    """
    course, frames = _run(network, sequences)
    return course.force, network.frame.force(frames)


def _run(network: FgerNetwork, sequences: Sequences) -> tuple[Course, Tensor]:
    """Return the course of all sequences from their start, and `frame_features` of all frames."""
    frames = encode(network, sequences)
    state = network.initial_state(sequences.force.shape[1])
    events = sequences.event_features.float()
    return network(events, frames, sequences.slots, state), frames


FOLLOWED = 0.8
"""Part of the difference to a frame's force that is corrected at first."""
_SMALL = 0.1
"""Factor of the other weights that end in a force."""


@torch.no_grad()
def follow_frames(network: FgerNetwork) -> None:
    """Make MLP_corr correct `FOLLOWED` of the difference to the frames-only force, in place.

    Two of its hidden units become the halves of that difference above and below zero; MLP_corr
    would have to learn from scratch what the head of the frame network knows already.

    Args:
        network: Its frame network is trained.
    """
    hidden, output = (network.correction.get_submodule(name) for name in ('0', '2'))
    head = network.frame.head
    weight = torch.cat([-torch.ones_like(head.bias), head.weight[0]])
    for unit, sign in enumerate((1.0, -1.0)):
        hidden.get_parameter('weight')[unit] = sign * weight
        hidden.get_parameter('bias')[unit] = sign * head.bias[0]
    for last in (output, network.increment.get_submodule('2')):
        last.get_parameter('weight').mul_(_SMALL)
        last.get_parameter('bias').zero_()
    output.get_parameter('weight')[0, :2] = torch.tensor([FOLLOWED, -FOLLOWED])


@torch.no_grad()
def share_convolutions(network: FgerNetwork, share: float) -> None:
    """Keep a share of the convolutions' features in the normal force, in place.

    Every layer of the normal force that reads their features of a frame reads them as
    rest + share (features - rest). What gives sideways force and torsion stays as it is.

    Args:
        network: Trained; its forces are moments with corrections by convolutions.
        share: 1 changes nothing; 0 leaves the features at rest.
    """
    frame, config = network.frame, network.config
    still = frame.mean.new_zeros(1, len(config.frame_channels), *config.frame_shape)
    rest = torch.relu(frame.project(frame.convolutions(still).flatten()))
    correction = network.correction.get_submodule('0')
    readers = [(frame.head, frame.head, 0), (correction, correction, 1)]
    if config.frame_context:
        readers.append((network.context, network.increment.get_submodule('0'), 0))
    for layer, biased, first in readers:
        weight = layer.get_parameter('weight')[:, first : first + config.frame_size]
        biased.get_parameter('bias').add_((1.0 - share) * (weight @ rest))
        weight.mul_(share)


IMPACT_N = 3.0
"""A larger force is an impact [N]; presses stay below."""
WINDOWS_BEFORE = 30
"""Windows before the impact, without contact, so that a stretch starts as a trial does."""
WINDOWS_AFTER = 70
"""Windows from the impact on; about three frames follow."""
RELEASED_N = 0.05
"""Largest force in the windows before [N]."""


def impacts(sequences: Sequences) -> Sequences | None:
    """Return a stretch around each impact that starts without contact, side by side.

    Args:
        sequences: Trials.

    Returns:
        `WINDOWS_BEFORE` + `WINDOWS_AFTER` windows of each impact; frames are those of `sequences`.
        None without any.
    """
    starts = _starts(sequences.force, sequences.valid)
    if not len(starts):
        return None
    first, trial = starts.unbind(1)
    rows = first[None] + torch.arange(WINDOWS_BEFORE + WINDOWS_AFTER, device=first.device)[:, None]
    return replace(
        sequences,
        event_features=sequences.event_features[rows, trial],
        force=sequences.force[rows, trial],
        across=sequences.across[rows, trial],
        valid=sequences.valid[rows, trial],
        slots=FrameSlots(*(part[rows, trial] for part in sequences.slots)),
        device=sequences.device[trial],
    )


def _starts(force: Tensor, valid: Tensor) -> Tensor:
    """Return first window and trial of each stretch, int64 [N, 2]."""
    strong = (force > IMPACT_N) & valid
    rising = strong.clone()
    rising[1:] &= ~strong[:-1]
    found = []
    for window, trial in torch.nonzero(rising).tolist():
        start = window - WINDOWS_BEFORE
        if start >= 0 and window + WINDOWS_AFTER <= len(force):
            # The first windows of the impact itself rise from zero.
            before = force[start : window - 2, trial]
            if float(before.abs().max()) < RELEASED_N:
                found.append((start, trial))
    return torch.tensor(found, dtype=torch.int64, device=force.device).reshape(-1, 2)


@dataclass(eq=False)
class SequenceStage(FgerStage):
    """Truncated back-propagation through all sequences of a group side by side.

    The gains stay as they are; the frame network learns in the stage `joint` only.
    """

    _features: dict[tuple[int, Flip], Tensor] = field(default_factory=dict)

    @property
    def joint(self) -> bool:
        """Whether the frame network learns as well."""
        return self.name == 'joint'

    def begin(self) -> None:
        """Initialise the recurrent path so that it follows the frames."""
        if not self.joint and not self.model.adapts:
            follow_frames(self.model.network)

    def parameters(self) -> list[nn.Parameter]:
        """Return what is trained."""
        network = self.model.network
        without = set() if self.joint else {id(p) for p in frame_parameters(network)}
        if network.config.deviation_size:
            without |= {id(p) for p in network.deviation.parameters()}
        return [p for p in network.parameters() if id(p) not in without]

    def updates(self) -> int:
        """Return the usual number of updates per epoch."""
        stretches = -(-self.groups.length // self.settings.chunk_windows)
        every = self.settings.blow_every
        return len(self.groups) * (stretches + (-(-stretches // every) if every else 0))

    def losses(self, random: torch.Generator) -> Iterator[Tensor]:
        """Yield the losses of one epoch, group by group in random order."""
        for group in torch.randperm(len(self.groups), generator=random).tolist():
            sequences = self.groups.load(group).to(self.model.device)
            flip = draw_flips(self.settings, random)
            frozen = None
            if not self.joint:
                # Features are small and stay what they are: kept for all groups.
                if (group, flip) not in self._features:
                    found = encode(self.model.network, sequences, flip)
                    self._features[group, flip] = found
                frozen = self._features[group, flip]
            state = self.model.network.initial_state(sequences.force.shape[1])
            cut_out = impacts(sequences) if self.settings.blow_every else None
            for number, (start, stop) in enumerate(self._chunks(len(sequences.force), random)):
                if cut_out is not None and number % self.settings.blow_every == 0:
                    # Each impact from no contact on.
                    begin = self.model.network.initial_state(cut_out.force.shape[1])
                    yield self._run(cut_out, slice(None), frozen, flip, begin)[0]
                loss, state = self._run(sequences, slice(start, stop), frozen, flip, state)
                yield loss
                # Truncated back-propagation: the gradient ends here.
                state = state.detach()

    def _run(
        self,
        sequences: Sequences,
        windows: slice,
        frozen: Tensor | None,
        flip: Flip,
        state: SequenceState,
    ) -> tuple[Tensor, SequenceState]:
        """Run a stretch with the features of its frames, or with gradients through them.

        With gradients the loss of the sideways force that the frames show is added. Forces count
        more the larger they are, as impacts are short. An estimate that is larger than the force
        counts as such a force would: if the force alone weighed, the expected loss were least at
        estimates that are too large.

        Returns:
            The mean loss, and the state after the stretch.
        """
        network, settings = self.model.network, self.settings
        slots = FrameSlots(*(part[windows] for part in sequences.slots))
        frames, aside = frozen, sequences.force.new_zeros(())
        if frames is None:
            used, index = torch.unique(slots.frame.clamp(min=0), return_inverse=True)
            frames = frame_features(network, sequences, used, flip)
            slots = FrameSlots(torch.where(slots.frame >= 0, index, -1), slots.lag)
            aside = self.model.across_loss(sequences, used, frames, flip, settings.loss_knee_n)
        events = mirror_events(sequences.event_features[windows].float(), *flip)
        course = network(events, frames, slots, state)
        valid, known = sequences.valid[windows], sequences.force[windows]
        force = self.model.gains[sequences.device, 0] * course.force
        errors = force_loss(force, known, settings.loss_knee_n)
        larger = torch.maximum(known.abs(), force.detach().abs())
        weights = valid * (1.0 + settings.force_weight * larger)
        loss = (errors * weights).sum() / weights.sum().clamp(min=1.0) + aside
        return loss, course.state

    def validate(self) -> float | None:
        """Return the mean absolute error on the trials to validate on [N]."""
        return mean_error(
            self.checked,
            self.model.device,
            lambda held: (estimate(self.model.network, held)[0] - held.force)[held.valid],
        )

    def _chunks(self, length: int, random: torch.Generator) -> Iterator[tuple[int, int]]:
        """Yield the stretches of one epoch; the first is cut at random so that borders move."""
        size = self.settings.chunk_windows
        first = int(torch.randint(size // 2, size + 1, (1,), generator=random))
        borders = [0, *range(min(first, length), length, size), length]
        yield from ((a, b) for a, b in pairwise(borders) if b > a)


COVERED = 0.6827
"""Part of the held-out windows within one deviation: that of a Gaussian."""
_WINDOWS = 100_000
"""Windows that are learned from, at most, drawn at random."""
_BATCH = 1024


class Errors(NamedTuple):
    """Windows of finished estimates.

    Attributes:
        hidden: Recurrent state, [N, lstm_size].
        force: Estimate [N], [N].
        moved: As in `Course` [N], [N].
        error: Estimate minus known force [N], [N].
        trials: Number of trials that they are from.
    """

    hidden: Tensor
    force: Tensor
    moved: Tensor
    error: Tensor
    trials: int


@dataclass(eq=False)
class DeviationStage(FgerStage):
    """Trains the uncertainty head; nothing else changes."""

    @cached_property
    def errors(self) -> Errors:
        """Windows of the finished estimates of the trials to train on."""
        return collect(self.model.network, self.groups)

    def parameters(self) -> list[nn.Parameter]:
        """Return the weights of the head."""
        return list(self.model.network.deviation.parameters())

    def updates(self) -> int:
        """Return the number of updates per epoch."""
        return -(-len(self.errors.error) // _BATCH)

    def losses(self, random: torch.Generator) -> Iterator[Tensor]:
        """Yield the losses of one epoch in random order."""
        errors, head = self.errors, self.model.network.deviation
        order = shuffled(len(errors.error), random)
        for chosen in torch.split(order, _BATCH):
            hidden, force, moved, error = (part[chosen] for part in errors[:4])
            log_deviation = head.log_deviation(hidden, force, moved)
            ratio = error.abs() * torch.exp(-log_deviation)
            yield torch.Tensor((log_deviation + ratio).mean())


@torch.no_grad()
def collect(network: FgerNetwork, groups: DiskGroups, most: int = _WINDOWS) -> Errors:
    """Return states, estimates and errors of at most `most` windows, drawn at random."""
    random = torch.Generator().manual_seed(0)
    share = max(most // len(groups), 1)
    device = next(network.parameters()).device
    parts, trials = [], 0
    for index in range(len(groups)):
        sequences = groups.load(index).to(device)
        course, _ = _run(network, sequences)
        rows = torch.nonzero(sequences.valid.flatten())[:, 0]
        rows = rows[torch.randperm(len(rows), generator=random)[:share].to(device)]
        error = course.force - sequences.force
        windows = (course.hidden.flatten(0, 1), course.force, course.moved, error)
        parts.append([windows[0][rows], *(each.flatten()[rows] for each in windows[1:])])
        trials += len(sequences.device)
    hidden, force, moved, wrong = (torch.cat(each) for each in zip(*parts, strict=True))
    return Errors(hidden, force, moved, wrong, trials)


@torch.no_grad()
def calibrate_deviation(network: FgerNetwork, errors: Errors) -> float:
    """Set the head's scale so that one deviation covers `COVERED` of a further trial; return it."""
    from scipy.stats import t as student

    head = network.deviation
    ratio = errors.error.abs() * torch.exp(-head.log_deviation(*errors[:3]))
    few_trials = float(student.ppf(0.5 * (1.0 + COVERED), errors.trials))
    scale = few_trials * float(torch.quantile(ratio, COVERED))
    head.scale.fill_(max(scale, 1e-3))
    return float(head.scale)


@torch.no_grad()
def shear_course(network: FgerNetwork, sequences: Sequences) -> Tensor:
    """Return `ShearHead.course` after each window, as the live estimator has it, [T, B, 2, 3].

    Args:
        network: With the head.
        sequences: Trials.
    """
    features = encode(network, sequences).cpu().numpy()
    events = sequences.event_features.float().cpu().numpy()
    slots = [part.cpu().numpy() for part in sequences.slots]
    tensors = arrays_of(network)
    out = np.zeros((*events.shape[:2], 2, 3), np.float32)
    for trial in range(events.shape[1]):
        head = ShearHead(network.config, tensors)
        for window in range(len(events)):
            frame, lag = (int(each[window, trial]) for each in slots)
            if frame >= 0:
                head.correct(head.measure(features[frame]), lag, SPREAD_WINDOWS)
            head.step(events[window, trial])
            out[window, trial] = head.course
    return torch.from_numpy(out)


def has_across(groups: DiskGroups) -> bool:
    """Return whether the force across the normal is known anywhere in the trials."""
    loaded = (groups.load(index) for index in range(len(groups)))
    return any(bool(torch.isfinite(each.across[each.valid]).any()) for each in loaded)


@torch.no_grad()
def calibrate_shear(network: FgerNetwork, groups: DiskGroups) -> None:
    """Fit the deviations of sideways force and torsion: floor and shares of `ShearHead`.

    Args:
        network: With the head.
        groups: Trials that were not trained on, some of them with the force across the normal.
    """
    from scipy.optimize import nnls

    terms, squares = [], []
    for index in range(len(groups)):
        sequences = groups.load(index).to(next(network.parameters()).device)
        kept = (sequences.valid & torch.isfinite(sequences.across).all(-1)).cpu()
        value, moved = shear_course(network, sequences)[kept].unbind(1)
        terms.append(torch.stack([torch.ones_like(value), value.square(), moved.square()], -1))
        squares.append((sequences.across.cpu()[kept] - value).square())
    inputs, errors = torch.cat(terms).double(), torch.cat(squares).double()
    for axes in ([0, 1], [2]):
        rows = inputs[:, axes].reshape(-1, 3).numpy()
        # Shares of all errors: by normal equations, as there are millions of rows.
        found, _ = nnls(rows.T @ rows, rows.T @ errors[:, axes].reshape(-1).numpy())
        network.shear.deviation[axes] = torch.from_numpy(found**0.5).float().to(network.shear.unit)


def train_fger(
    config: FgerConfig,
    settings: TrainingSettings,
    groups: DiskGroups,
    checked: DiskGroups | None = None,
    *,
    start: FgerNetwork | None = None,
    **options: Any,  # noqa: ANN401
) -> tuple[FgerNetwork, list[dict[str, Any]]]:
    """Run all stages and return the network, on the CPU in evaluation mode, and the curves.

    Args:
        config: Network configuration.
        settings: Stages and rates.
        groups: Trials to train on.
        checked: Trials to validate on; None for none.
        start: Trained network to adapt; None for random weights.
        options: Of `TrainingLoop`: checkpoint, fingerprint and show.

    Raises:
        TrainingError: As `TrainingLoop.run`, or no trial has what `FgerConfig.shear` learns from.
    """
    learns_across = config.shear and start is None
    if learns_across and not mean(torch.tensor(float(has_across(groups)))):
        raise TrainingError(
            'network.shear is set, but the sideways force of no trial is known: only simulated'
            ' trials hold it',
            remedy='set network.shear to false, or name simulated trials as well',
        )
    torch.manual_seed(settings.seed)
    model = NetworkWithGains(config, groups.devices, start)
    if start is None:
        model.fit_scales(groups.load(0))
    average_weights(model)
    model.to(usual_device())
    loop = TrainingLoop(
        model,
        seed=settings.seed,
        weight_decay=settings.weight_decay,
        patience=settings.patience,
        **options,
    )
    plan: list[tuple[type[FgerStage], str, int, float]] = [
        (FrameStage, 'frames', settings.frame_epochs, settings.frame_rate),
        (SequenceStage, 'recurrent', settings.recurrent_epochs, settings.recurrent_rate),
        (SequenceStage, 'joint', settings.joint_epochs, settings.joint_rate),
        (DeviationStage, 'deviation', settings.deviation_epochs, settings.deviation_rate),
    ]
    stages = [
        kind(name, epochs, rate, model, groups, settings, checked)
        for kind, name, epochs, rate in plan
        if name != 'deviation' or config.deviation_size
    ]
    loop.run(stages)
    network = model.network.eval()
    if config.reads_flow and start is None:
        # Not before: the stages would learn it back. A network to start from has been through it.
        share_convolutions(network, settings.convolution_share)
    if config.deviation_size:
        # Errors of trials that were trained on are too small to calibrate by.
        calibrate_deviation(network, collect(network, checked or groups))
    if learns_across:
        held = checked if checked is not None and has_across(checked) else groups
        calibrate_shear(network, held)
    return network.cpu(), loop.progress.curves
