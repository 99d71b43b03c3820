# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Training FGER-Net: the forces of frames are fitted first, then events learn the changes.

In training the force is that of the latest frame plus the increments since its exposure, without
the gains of the sensor's events. The deviations are fitted afterwards, on trials that were not
trained on, with the live estimator. The gains of the sensors are not used there, because the error
caused by an unknown stiffness belongs to the deviation.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from mixtac_fger.config import FgerConfig
from mixtac_fger.fger_net import SPREAD_WINDOWS
from mixtac_fger.force_path import ForcePath
from mixtac_learning.network import (
    FgerNetwork,
    FrameSlots,
    SequenceState,
    arrays_of,
    usual_device,
)
from mixtac_learning.train.config import TrainingSettings
from mixtac_learning.train.frame_fit import fit_frames
from mixtac_learning.train.loop import Stage, TrainingError, TrainingLoop, average_weights
from mixtac_learning.train.sequences import (
    DiskGroups,
    Flip,
    Sequences,
    draw_flips,
    features_of,
    force_loss,
    mirror_events,
)


@torch.no_grad()
def estimate(network: FgerNetwork, sequences: Sequences) -> Tensor:
    """Return the force at the end of each window of sequences from their start, [T, B] in N."""
    state = network.initial_state(sequences.force.shape[1])
    events, frames = sequences.event_features.float(), features_of(network, sequences)
    return torch.Tensor(network(events, frames, sequences.slots, state)[0])


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
class SequenceStage(Stage):
    """Truncated back-propagation through all sequences of a group side by side.

    Attributes:
        network: Its frames have been fitted.
        gains: Of each sensor, of `mixtac_learning.train.frame_fit.fit_frames`.
        groups: Trials to train on.
        settings: Settings of the run.
        checked: Validation trials; None for none.
        adapts: Whether a trained network is adapted.
    """

    network: FgerNetwork
    gains: Tensor
    groups: DiskGroups
    settings: TrainingSettings
    checked: DiskGroups | None
    adapts: bool

    @torch.no_grad()
    def begin(self) -> None:
        """Let the force follow the frames at first: the increments begin small."""
        if not self.adapts:
            last = self.network.increment.get_submodule('2')
            last.get_parameter('weight').mul_(SMALL)
            last.get_parameter('bias').zero_()

    def parameters(self) -> list[nn.Parameter]:
        """Return what is trained."""
        return list(self.network.parameters())

    def updates(self) -> int:
        """Return the usual number of updates per epoch."""
        stretches = -(-self.groups.length // self.settings.chunk_windows)
        every = self.settings.blow_every
        return len(self.groups) * (stretches + (-(-stretches // every) if every else 0))

    def losses(self, random: torch.Generator) -> Iterator[Tensor]:
        """Yield the losses of one epoch, group by group in random order."""
        network = self.network
        for group in torch.randperm(len(self.groups), generator=random).tolist():
            sequences = self.groups.load(group).to(self.gains.device)
            flip = draw_flips(self.settings, random)
            frames = features_of(network, sequences, flip)
            state = network.initial_state(sequences.force.shape[1])
            cut_out = impacts(sequences) if self.settings.blow_every else None
            for number, (start, stop) in enumerate(self._chunks(len(sequences.force), random)):
                if cut_out is not None and number % self.settings.blow_every == 0:
                    # Each impact from no contact on.
                    begin = network.initial_state(cut_out.force.shape[1])
                    yield self._run(cut_out, slice(None), frames, flip, begin)[0]
                loss, state = self._run(sequences, slice(start, stop), frames, flip, state)
                yield loss
                # Truncated back-propagation: the gradient ends here.
                state = state.detach()

    def _run(
        self, sequences: Sequences, windows: slice, frames: Tensor, flip: Flip, state: SequenceState
    ) -> tuple[Tensor, SequenceState]:
        """Run a stretch. Forces count more the larger they are, as impacts are short.

        An estimate that is larger than the force counts as such a force would: if the force alone
        weighed, the expected loss were least at estimates that are too large.

        Returns:
            The mean loss, and the state after the stretch.
        """
        slots = FrameSlots(*(part[windows] for part in sequences.slots))
        events = mirror_events(sequences.event_features[windows].float(), *flip)
        found, state = self.network(events, frames, slots, state)
        valid, known = sequences.valid[windows], sequences.force[windows]
        force = self.gains[sequences.device, 0] * found
        errors = force_loss(force, known, self.settings.loss_knee_n)
        larger = torch.maximum(known.abs(), force.detach().abs())
        weights = valid * (1.0 + self.settings.force_weight * larger)
        return (errors * weights).sum() / weights.sum().clamp(min=1.0), state

    def validate(self) -> float | None:
        """Return the mean absolute error on the trials to validate on [N]."""
        if self.checked is None:
            return None
        total, count = 0.0, 0
        for index in range(len(self.checked)):
            held = self.checked.load(index).to(self.gains.device)
            errors = (estimate(self.network, held) - held.force)[held.valid]
            total, count = total + float(errors.abs().sum()), count + len(errors)
        return total / count

    def _chunks(self, length: int, random: torch.Generator) -> Iterator[tuple[int, int]]:
        """Yield the stretches of one epoch; the first is cut at random so that borders move."""
        size = self.settings.chunk_windows
        first = int(torch.randint(size // 2, size + 1, (1,), generator=random))
        borders = [0, *range(min(first, length), length, size), length]
        yield from ((a, b) for a, b in pairwise(borders) if b > a)


@torch.no_grad()
def live_course(network: FgerNetwork, sequences: Sequences) -> Tensor:
    """Run trials as the live estimator does, with the gains of each sensor.

    Args:
        network: Trained.
        sequences: Trials.

    Returns:
        `ForcePath.course` after each window, of sideways force and torsion less what the output has
        yet to follow, [T, B, 2, 1 or 4] in N and N mm.
    """
    config, tensors = network.config, arrays_of(network)
    events, moments, frame, lags = (
        part.cpu().numpy()
        for part in (sequences.event_features, sequences.frame_moments, *sequences.slots)
    )
    found = np.zeros((*frame.shape, 2, 4 if config.shear else 1), np.float32)
    for trial in range(frame.shape[1]):
        path = ForcePath(config, tensors)
        for window, row in enumerate(frame[:, trial].tolist()):
            if row >= 0:
                path.correct(path.measure(moments[row]), int(lags[window, trial]), SPREAD_WINDOWS)
            path.step(events[window, trial].astype(np.float32))
            found[window, trial] = path.course()
            found[window, trial, 0, 1:] -= path.pending[1:]
    return torch.from_numpy(found)


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
            are fitted where they are known, in contact.
    """
    normal, across, trials = [], [], 0
    for index in range(len(groups)):
        sequences = groups.load(index).to(next(network.parameters()).device)
        value, moved = live_course(network, sequences).unbind(-2)
        kept, known = sequences.valid.cpu(), sequences.force.cpu()
        rows = torch.stack([value[..., 0], moved[..., 0], value[..., 0] - known], -1)
        normal.append(rows[kept])
        trials += kept.shape[1]
        if network.config.shear:
            # Without contact both are zero, and so would be the floor.
            known_across = sequences.across.cpu()
            kept = kept & (known > RELEASED_N) & torch.isfinite(known_across).all(-1)
            value, moved = value[..., 1:], moved[..., 1:]
            across.append(torch.stack([value, moved, value - known_across], -1)[kept])
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
    """Fit and train a network; returns it, on the CPU in evaluation mode, and the curves.

    Args:
        config: Network configuration.
        settings: Epochs and rates.
        groups: Trials to train on.
        checked: Trials to validate on; None for none.
        start: Trained network to adapt; None for random weights.
        options: Of `TrainingLoop`: checkpoint, fingerprint and show.

    Raises:
        TrainingError: As `TrainingLoop.run`, or no trial has what `FgerConfig.shear` learns from.
    """
    frames, learns_across = groups.frames(), config.shear and start is None
    if learns_across and not frames.known.any():
        raise TrainingError(
            'network.shear is set, but the sideways force of no trial is known: only simulated'
            ' trials hold it',
            remedy='set network.shear to false, or name simulated trials as well',
        )
    torch.manual_seed(settings.seed)
    network = FgerNetwork(config) if start is None else start
    gains = fit_frames(network, frames, adapts=start is not None)
    if start is None:
        first = groups.load(0)
        events = first.event_features[first.valid].float().flatten(0, -2)
        network.event.scale.copy_(events.square().mean(0).sqrt().clamp(min=1e-3))
    average_weights(network)
    device = usual_device()
    loop = TrainingLoop(
        network.to(device),
        seed=settings.seed,
        weight_decay=settings.weight_decay,
        patience=settings.patience,
        **options,
    )
    stage = SequenceStage(
        'recurrent',
        settings.recurrent_epochs,
        settings.recurrent_rate,
        network,
        gains.to(device),
        groups,
        settings,
        checked,
        adapts=start is not None,
    )
    loop.run([stage])
    network.eval()
    if checked is None or (learns_across and not checked.frames().known.any()):
        checked = groups
    calibrate_deviations(network, checked)
    return network.cpu(), loop.progress.curves
