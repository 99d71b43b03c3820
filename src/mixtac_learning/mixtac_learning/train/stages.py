# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Training FGER-Net in stages: frame network, recurrent path, both together.

In training the force is that of the latest frame plus the increments since its exposure, without
the gains of the sensor's events. The deviations are fitted afterwards, on trials that were not
trained on, with the live estimator. The gains of the sensors are not used there, because the error
caused by an unknown stiffness belongs to the deviation.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from mixtac_fger.config import MOMENTS, FgerConfig
from mixtac_fger.fger_net import SPREAD_WINDOWS
from mixtac_fger.recurrent_network import RecurrentPath
from mixtac_fger.shear import FlowMoments, ShearHead
from mixtac_learning.network import (
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
)
from mixtac_learning.train.loop import TrainingError, TrainingLoop, average_weights, mean


@torch.no_grad()
def estimate(network: FgerNetwork, sequences: Sequences) -> tuple[Tensor, Tensor]:
    """Run all sequences from their start.

    Returns:
        Force at the end of each window [T, B] and frames-only force of each frame [N], in N.
    """
    frames = encode(network, sequences)
    state = network.initial_state(sequences.force.shape[1])
    course = network(sequences.event_features.float(), frames, sequences.slots, state)
    return course.force, network.frame.force(frames)


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
    readers: list[tuple[nn.Module, nn.Module]] = [(frame.head, frame.head)]
    if config.frame_context:
        readers.append((network.context, network.increment.get_submodule('0')))
    for layer, biased in readers:
        weight = layer.get_parameter('weight')[:, : config.frame_size]
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


SMALL = 0.1
"""Factor of the last weights of the increments before their training."""


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

    @torch.no_grad()
    def begin(self) -> None:
        """Let the force follow the frames at first: the increments begin small."""
        if not self.joint and not self.model.adapts:
            last = self.model.network.increment.get_submodule('2')
            last.get_parameter('weight').mul_(SMALL)
            last.get_parameter('bias').zero_()

    def parameters(self) -> list[nn.Parameter]:
        """Return what is trained."""
        network = self.model.network
        without = set() if self.joint else {id(p) for p in frame_parameters(network)}
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


class LiveCourse(NamedTuple):
    """Values after each window as the live estimator has them, N, N and N mm.

    Attributes:
        force: Normal force, [T, B].
        moved: Its change since the exposure of the latest frame, by events, [T, B].
        across: `ShearHead.course`, [T, B, 2, 3]; zeros without the head.
    """

    force: Tensor
    moved: Tensor
    across: Tensor


@torch.no_grad()
def live_course(network: FgerNetwork, sequences: Sequences) -> LiveCourse:
    """Run trials as the live estimator does, with the gains of each sensor.

    Args:
        network: Trained.
        sequences: Trials.
    """
    config, tensors = network.config, arrays_of(network)
    frames = encode(network, sequences)
    forces = network.frame.force(frames).cpu().numpy()
    features, events, frame, lags = (
        part.cpu().numpy() for part in (frames, sequences.event_features.float(), *sequences.slots)
    )
    spread, head = tensors.get('frame.spread'), tensors['frame.head.weight'][0, -MOMENTS:]
    moments = None if spread is None else FlowMoments(config, spread)
    press, found = np.zeros((*config.grid_shape, 2)), np.zeros((*events.shape[:2], 8), np.float32)
    for trial in range(events.shape[1]):
        path = RecurrentPath(config, tensors)
        shear = ShearHead(config, tensors) if config.shear else None
        for window in range(len(events)):
            if (row := int(frame[window, trial])) >= 0:
                lag = int(lags[window, trial])
                path.correct(float(forces[row]), lag)
                if moments is not None:
                    per_flow = moments.per_flow(features[row])
                    press = np.tensordot(head, per_flow, 1)
                    if shear is not None:
                        shear.correct(shear.measure(features[row], per_flow), lag, SPREAD_WINDOWS)
                path.see(features[row], press)
            path.step(events[window, trial])
            found[window, trial, :2] = path.force, path.moved
            if shear is not None:
                shear.step(events[window, trial])
                found[window, trial, 2:] = shear.course.ravel()
    force, moved, across = np.split(found, [1, 2], axis=-1)
    across = across.reshape(*across.shape[:-1], 2, 3)
    return LiveCourse(*(torch.from_numpy(each) for each in (force[..., 0], moved[..., 0], across)))


def has_across(groups: DiskGroups) -> bool:
    """Return whether the force across the normal is known anywhere in the trials."""
    loaded = (groups.load(index) for index in range(len(groups)))
    return any(bool(torch.isfinite(each.across[each.valid]).any()) for each in loaded)


COVERED = 0.6827
"""Part of the held-out windows within one deviation: that of a Gaussian."""
MOST_ROWS = 100_000
"""Windows that the deviations are fitted to, at most, evenly over all."""


@torch.no_grad()
def calibrate_deviations(network: FgerNetwork, groups: DiskGroups) -> None:
    """Fit the deviations of all forces, each by a floor and two shares.

    Args:
        network: Trained.
        groups: Trials that were not trained on, as errors of others are too small; sideways forces
            are fitted where they are known.
    """
    normal, across, trials = [], [], 0
    for index in range(len(groups)):
        sequences = groups.load(index).to(next(network.parameters()).device)
        found, kept = live_course(network, sequences), sequences.valid.cpu()
        force, moved, known = (
            each[kept] for each in (found.force, found.moved, sequences.force.cpu())
        )
        normal.append(torch.stack([force, moved, force - known], -1))
        trials += kept.shape[1]
        if network.config.shear:
            kept = kept & torch.isfinite(sequences.across.cpu()).all(-1)
            value, moved = found.across[kept].unbind(1)
            across.append(torch.stack([value, moved, value - sequences.across.cpu()[kept]], -1))
    fitted = _floor_and_shares(torch.cat(normal).double().numpy(), trials)
    network.deviation.copy_(torch.from_numpy(fitted))
    if across and len(sideways := torch.cat(across).double().numpy()):
        for axes in ([0, 1], [2]):
            fitted = _floor_and_shares(sideways[:, axes].reshape(-1, 3), trials)
            network.shear.deviation[axes] = torch.from_numpy(fitted).float().to(network.shear.unit)


def _floor_and_shares(rows: NDArray[np.float64], trials: int) -> NDArray[np.float64]:
    """Return floor and shares by rows of value, change by events, and error.

    The likelihood is Laplacian, as errors have heavy tails; the scale is fitted afterwards, so that
    one deviation to both sides covers `COVERED`. Errors within one trial are correlated: n trials
    determine the scale like n independent draws, and a further trial spreads like Student's t with
    n degrees of freedom.
    """
    from scipy.optimize import minimize
    from scipy.stats import t as student

    rows = rows[:: -(-len(rows) // MOST_ROWS)]
    squares, errors = rows[:, :2] ** 2, np.abs(rows[:, 2])
    start = np.log([np.quantile(errors, 0.2) + 1e-4, 0.1, 0.3])

    def deviation(logs: NDArray[np.float64]) -> NDArray[np.float64]:
        floor, value, moved = np.exp(2.0 * logs)
        return np.asarray(np.sqrt(floor + squares @ [value, moved]))

    def loss(logs: NDArray[np.float64]) -> float:
        found = deviation(logs)
        return float((np.log(found) + errors / found).mean())

    logs = minimize(loss, start, method='Nelder-Mead').x
    few = float(student.ppf(0.5 * (1.0 + COVERED), trials))
    scale = few * float(np.quantile(errors / deviation(logs), COVERED))
    return np.asarray(scale * np.exp(logs))


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
    ]
    loop.run(
        [
            kind(name, epochs, rate, model, groups, settings, checked)
            for kind, name, epochs, rate in plan
        ]
    )
    network = model.network.eval()
    if config.reads_flow and start is None:
        # Not before: the stages would learn it back. A network to start from has been through it.
        share_convolutions(network, settings.convolution_share)
    if checked is None or (learns_across and not has_across(checked)):
        checked = groups
    calibrate_deviations(network, checked)
    return network.cpu(), loop.progress.curves
