# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The first stage of training FGER-Net: the frame network and the gains of the sensors.

It begins with the forces of the moments alone, and what the convolutions add is kept small. The
losses of forces are those of the later stages too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import torch
from torch import Tensor, nn
from torch.nn.functional import linear, smooth_l1_loss

from mixtac_fger.config import FgerConfig
from mixtac_learning.network import FgerNetwork
from mixtac_learning.train.batches import (
    DiskGroups,
    Sequences,
    mirror_across,
    mirror_frames,
    mirror_moments,
)
from mixtac_learning.train.config import TrainingSettings
from mixtac_learning.train.loop import Processes, Stage

Flip = tuple[bool, bool]


_ENCODE_BATCH = 512
ACROSS_UNITS = (1.0, 1.0, 10.0)
"""What counts as much as a newton in the loss: sideways force [N], torsion [N mm].

Most of the time there is no torsion: were the knee of the loss below its usual size, no torsion
would ever be told.
"""


class NetworkWithGains(nn.Module):
    """FGER-Net and the gains of the sensors of the training data.

    How stiff a gel is cannot be seen: force is stiffness times what is seen. So each sensor of the
    training data has a gain of the normal force and one of the force across it, learned with the
    frame network and drawn towards 1, and the network learns the force on a gel of usual stiffness.
    A new sensor's gains are 1 until it is calibrated (`mixtac_learning.judge.metrics`).

    Args:
        config: Network configuration.
        devices: Number of sensors.
        start: Trained network to adapt to these sensors; None for random weights. Its features of
            frames and its forces across the normal stay, and so do the gains: they are 1.

    Attributes:
        adapts: Whether a trained network is adapted.
    """

    def __init__(self, config: FgerConfig, devices: int, start: FgerNetwork | None = None) -> None:
        super().__init__()
        self.network = FgerNetwork(config) if start is None else start
        self.adapts = start is not None
        self.log_gains = nn.Parameter(torch.zeros(devices, 2))

    @property
    def device(self) -> torch.device:
        """Where the weights are."""
        return self.log_gains.device

    @property
    def gains(self) -> Tensor:
        """Gains of each sensor, by `Sequences.device`, [devices, 2]; without gradient."""
        return self.log_gains.detach().exp()

    def across_loss(
        self, sequences: Sequences, rows: Tensor, seen: Tensor, flip: Flip, knee: float
    ) -> Tensor:
        """Return the mean loss of sideways force and torsion of frames, 0 where they are unknown.

        Args:
            sequences: Trials.
            rows: Which frames, [N].
            seen: Their f_frame, [N, feature_size].
            flip: Whether columns and rows were mirrored.
            knee: Errors above this count linearly, below it quadratically [N].
        """
        if not self.network.config.shear:
            return seen.new_zeros(())
        sideways = self.log_gains[sequences.device[sequences.frame_trial[rows]], 1].exp()
        across = sideways[:, None] * self.network.shear.shown(seen)
        known = mirror_across(sequences.frame_across[rows], *flip)
        units, told = across.new_tensor(ACROSS_UNITS), torch.isfinite(known)
        label = torch.where(told, known, across.detach())
        errors = smooth_l1_loss(across / units, label / units, beta=knee, reduction='none')
        return torch.Tensor((errors * told).sum() / told.sum().clamp(min=1.0))

    def fit_scales(self, sequences: Sequences) -> None:
        """Set the input scales to the spread of the data; signed inputs keep their zero."""
        network = self.network
        events = sequences.event_features[sequences.valid].float()
        network.event.scale.copy_(events.flatten(0, -2).square().mean(0).sqrt().clamp(min=1e-3))
        frames = sequences.frame_inputs.float()
        scale = frames.square().mean((0, 2, 3)).sqrt()
        if 'frame' in network.config.frame_channels:
            channel = network.config.frame_channels.index('frame')
            network.frame.mean[channel] = frames[:, channel].mean()
            scale[channel] = frames[:, channel].std()
        network.frame.scale.copy_(scale.clamp(min=1e-3)[:, None, None])
        if network.config.reads_flow:
            square = sequences.frame_moments.square().mean(0)
            for axes in ([1, 2], [3, 4]):
                square[axes] = square[axes].mean()  # one scale for both directions
            network.frame.spread.copy_(square.sqrt().clamp(min=1e-3))


def looks(
    network: FgerNetwork,
    sequences: Sequences,
    rows: Tensor | slice = slice(None),
    flip: Flip = (False, False),
) -> Tensor:
    """Return f_frame of some frames, or of their mirror images, [N, feature_size].

    Args:
        network: FGER-Net.
        sequences: Trials.
        rows: Which frames.
        flip: Whether to mirror columns and rows.
    """
    inputs = mirror_frames(sequences.frame_inputs[rows].float(), network.config, *flip)
    moments = mirror_moments(sequences.frame_moments[rows], *flip)
    return torch.Tensor(network.frame(inputs, moments))


@torch.no_grad()
def encode(network: FgerNetwork, sequences: Sequences, flip: Flip = (False, False)) -> Tensor:
    """Return `looks` of all frames, without gradients."""
    starts = range(0, len(sequences.frame_inputs), _ENCODE_BATCH)
    parts = [slice(start, start + _ENCODE_BATCH) for start in starts]
    return torch.cat([looks(network, sequences, part, flip) for part in parts])


def mean_error(
    groups: DiskGroups | None,
    device: torch.device,
    errors: Callable[[Sequences], Tensor],
) -> float | None:
    """Return the mean absolute error over groups of trials [N]; None without groups.

    Args:
        groups: Trials to validate on.
        device: Where to compute.
        errors: Returns the errors of one group [N].
    """
    if groups is None:
        return None
    total, count = 0.0, 0
    for index in range(len(groups)):
        error = errors(groups.load(index).to(device))
        total, count = total + float(error.abs().sum()), count + len(error)
    return total / count


@dataclass(eq=False)
class FgerStage(Stage):
    """What the stages of FGER-Net share.

    Attributes:
        name: `frames`, `recurrent`, `joint` or `deviation`.
        epochs: Epochs.
        rate: Largest learning rate.
        model: Network and gains.
        groups: Trials to train on.
        settings: Settings of the run.
        checked: Validation trials; None for none.
        processes: Processes that share the training.
    """

    name: str
    epochs: int
    rate: float
    model: NetworkWithGains
    groups: DiskGroups
    settings: TrainingSettings
    checked: DiskGroups | None = None
    processes: Processes = field(default_factory=Processes)


class FrameStage(FgerStage):
    """Trains the frame network and the gains of the sensors on single frames."""

    def begin(self) -> None:
        """Begin with the moments alone: the convolutions learn what these leave over."""
        if self.model.network.config.reads_flow and not self.model.adapts:
            follow_moments(self.model.network, self.groups.load(0), self.processes)

    def parameters(self) -> list[nn.Parameter]:
        """Return the weights that a frame's forces come from, and the gains.

        Of a trained network only the weights from its features to the normal force.
        """
        if self.model.adapts:
            return list(self.model.network.frame.head.parameters())
        return [*frame_parameters(self.model.network), self.model.log_gains]

    def updates(self) -> int:
        """Return the number of updates per epoch, the same in all processes."""
        return sum(self._batches(index) for index in range(self._groups()))

    def losses(self, random: torch.Generator) -> Iterator[Tensor]:
        """Yield the losses of one epoch: groups in random order, frames shuffled within each."""
        for group in torch.randperm(self._groups(), generator=random).tolist():
            sequences = self.groups.load(group).to(self.model.device)
            labels = sequences.frame_force
            device = sequences.device[sequences.frame_trial]
            order = shuffled(len(labels), random)
            rows = torch.split(order, self.settings.frame_batch)[: self._batches(group)]
            for chosen in rows:
                flips, network = draw_flips(self.settings, random), self.model.network
                seen = looks(network, sequences, chosen, flips)
                force = network.frame.force(seen)
                normal = self.model.log_gains[device[chosen], 0].exp()
                knee = self.settings.loss_knee_n
                loss = force_loss(normal * force, labels[chosen], knee).mean()
                loss = loss + self.model.across_loss(sequences, chosen, seen, flips, knee)
                if network.config.reads_flow:
                    loss = loss + self.settings.moments_prior * beside_moments(network, seen)
                yield loss + self.settings.gain_prior * self.model.log_gains.square().mean()

    def validate(self) -> float | None:
        """Return the mean absolute error of frames alone on the trials to validate on [N]."""
        network = self.model.network
        return mean_error(
            self.checked,
            self.model.device,
            lambda held: network.frame.force(encode(network, held)) - held.frame_force,
        )

    def _groups(self) -> int:
        return self.processes.smallest(len(self.groups))

    def _batches(self, group: int) -> int:
        own = -(-len(self.groups.load(group).frame_force) // self.settings.frame_batch)
        return self.processes.smallest(own)


@torch.no_grad()
def follow_moments(network: FgerNetwork, sequences: Sequences, processes: Processes) -> None:
    """Make the forces of frames those of the moments alone, by least squares, in place.

    Args:
        network: `NetworkWithGains.fit_scales` has been called.
        sequences: Trials to fit the constants to.
        processes: Processes that take the mean of theirs.
    """
    moments = (sequences.frame_moments / network.frame.spread.cpu()).double()
    first = network.config.frame_size
    heads = [(network.frame.head, [[0]], sequences.frame_force[:, None])]
    if network.config.shear:
        heads += [(network.shear.frame, [[1, 3], [2, 4]], sequences.frame_across[:, :2])]
    for head, columns, known in heads:
        told = torch.isfinite(known).all(1)
        inputs = torch.cat([moments[told][:, each] for each in columns])
        found = torch.linalg.lstsq(inputs, known[told].T.reshape(-1, 1).double()).solution[:, 0]
        found = processes.mean(found)
        head.weight.zero_()
        head.bias.zero_()
        for row, each in enumerate(columns):
            head.weight[row, [first + column for column in each]] = found.to(head.weight)


def beside_moments(network: FgerNetwork, features: Tensor) -> Tensor:
    """Return the mean square of what the convolutions add to the forces of moments [N^2].

    Args:
        network: FGER-Net.
        features: f_frame, [N, feature_size].
    """
    own = features[:, : network.config.frame_size]
    heads = [network.frame.head, *([network.shear.frame] if network.config.shear else [])]
    added = [linear(own, head.weight[:, : own.shape[1]], head.bias) for head in heads]
    return torch.cat(added, dim=1).square().mean()


def frame_parameters(network: FgerNetwork) -> list[nn.Parameter]:
    """Return the weights that a frame's forces come from."""
    shear = [network.shear.frame, network.shear.turning] if network.config.shear else []
    return [each for part in (network.frame, *shear) for each in part.parameters()]


SMALL_N = 0.1
"""Force from which on the knee of the loss is the whole one [N]: below, a contact begins or ends,
and hundredths of a newton matter."""
LEAST_KNEE = 0.2
"""Share of the knee at no force."""


def force_loss(force: Tensor, known: Tensor, knee: float) -> Tensor:
    """Return the loss of each force: quadratic below the knee, linear above it.

    Args:
        force: Estimates [N].
        known: Labels [N], same shape.
        knee: Errors above this count linearly, above a smaller one near no force [N].
    """
    knees = knee * (known.abs() / SMALL_N).clamp(LEAST_KNEE, 1.0)
    error = (force - known).abs()
    return torch.where(error < knees, 0.5 * error.square() / knees, error - 0.5 * knees)


def shuffled(count: int, random: torch.Generator) -> Tensor:
    """Return numbers below a count in random order.

    Processes may have other counts: what they draw from `random` afterwards stays the same.
    """
    own = torch.Generator().manual_seed(int(torch.randint(2**31, (1,), generator=random)))
    return torch.randperm(count, generator=own)


def draw_flips(settings: TrainingSettings, random: torch.Generator) -> Flip:
    """Return whether to mirror columns and rows this time."""
    if not settings.mirror:
        return False, False
    columns, rows = torch.randint(0, 2, (2,), generator=random).tolist()
    return bool(columns), bool(rows)
