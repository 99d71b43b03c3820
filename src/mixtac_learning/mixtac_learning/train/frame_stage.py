# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The first stage of training FGER-Net: the frame network and the gains of the sensors.

It begins with the forces of the moments alone, and a penalty keeps the part of the convolutions
small. The later stages use the same force losses and the same sequences: trials side by side, in
groups from disk, mirrored at random.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import linear, smooth_l1_loss

from mixtac_fger.config import FgerConfig
from mixtac_learning.network import FgerNetwork, FrameSlots
from mixtac_learning.train.config import TrainingSettings
from mixtac_learning.train.loop import Stage
from mixtac_learning.trials.samples import Sample, load_sample
from mixtac_learning.trials.trial import sensor_of


@dataclass(frozen=True, slots=True, eq=False)
class Sequences:
    """B trials side by side, padded at their ends to T windows.

    Attributes:
        event_features: float16 [T, B, grid rows, grid columns, 4].
        force: Labels [N], float32 [T, B].
        across: Sideways force x, y [N] and torsion [N mm], nan where unknown, float32 [T, B, 3].
        valid: False in the padding, bool [T, B].
        slots: Frames by index into `frame_inputs`.
        frame_inputs: All frames of all trials, float16 [N, channels, rows, columns].
        frame_moments: Moments of each frame (`mixtac_fger.shear`), float32 [N, 9 or 0].
        frame_force: Mean label per exposure [N], float32 [N].
        frame_across: As `across`, at the centre of each exposure, float32 [N, 3].
        frame_trial: Which trial each frame belongs to, int64 [N].
        device: Which sensor each trial was made with, counted from 0, int64 [B].
    """

    event_features: Tensor
    force: Tensor
    across: Tensor
    valid: Tensor
    slots: FrameSlots
    frame_inputs: Tensor
    frame_moments: Tensor
    frame_force: Tensor
    frame_across: Tensor
    frame_trial: Tensor
    device: Tensor

    def to(self, target: torch.device) -> Sequences:
        """Return the sequences with everything that is computed with on a device."""
        if target.type == 'cpu':
            return self
        moved = {name: getattr(self, name).to(target) for name in self.__slots__ if name != 'slots'}
        return Sequences(**moved, slots=FrameSlots(*(part.to(target) for part in self.slots)))


def stack(
    samples: Sequence[Sample],
    devices: Sequence[int] | None = None,
    length: int | None = None,
) -> Sequences:
    """Put trials side by side.

    Args:
        samples: Trials.
        devices: Number of the sensor of each; None if each is of another.
        length: Windows to pad to; None for those of the longest.
    """
    if length is None:
        length = max(len(sample.force) for sample in samples)
    counts = [len(sample.frame_force) for sample in samples]
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]])

    def padded(name: str, fill: int = 0) -> Tensor:
        arrays = [getattr(sample, name) for sample in samples]
        out = np.full((length, len(arrays), *arrays[0].shape[1:]), fill, arrays[0].dtype)
        for column, array in enumerate(arrays):
            out[: len(array), column] = array
        return torch.from_numpy(out)

    index = padded('slots', -1)
    shifted = torch.where(index >= 0, index + torch.from_numpy(starts), -1)
    lengths = torch.tensor([len(sample.force) for sample in samples])
    joined = ('frame_inputs', 'frame_moments', 'frame_force', 'frame_across')
    return Sequences(
        **{name: padded(name) for name in ('event_features', 'force', 'across')},
        **{
            name: torch.from_numpy(np.concatenate([getattr(sample, name) for sample in samples]))
            for name in joined
        },
        valid=torch.arange(length)[:, None] < lengths[None],
        slots=FrameSlots(shifted, padded('lags')),
        frame_trial=torch.repeat_interleave(torch.arange(len(samples)), torch.tensor(counts)),
        device=torch.tensor(list(range(len(samples)) if devices is None else devices)),
    )


def mirror_frames(frames: Tensor, config: FgerConfig, columns: bool, rows: bool) -> Tensor:
    """Return network inputs [..., channels, rows, columns] as a mirrored sensor would give them."""
    axes = [axis for axis, wanted in ((-2, rows), (-1, columns)) if wanted]
    turned = {'flow_x': columns, 'flow_y': rows}
    signs = [-1.0 if turned.get(name, False) else 1.0 for name in config.frame_channels]
    sign = torch.tensor(signs, dtype=frames.dtype, device=frames.device)
    return frames.flip(axes) * sign[:, None, None]


def mirror_events(features: Tensor, columns: bool, rows: bool) -> Tensor:
    """Return grid features [..., rows, columns, 4] as a mirrored sensor would give them."""
    axes = [axis for axis, wanted in ((-3, rows), (-2, columns)) if wanted]
    signs = [-1.0 if columns else 1.0, -1.0 if rows else 1.0, 1.0, 1.0]
    return features.flip(axes) * torch.tensor(signs, dtype=features.dtype, device=features.device)


def mirror_moments(moments: Tensor, columns: bool, rows: bool) -> Tensor:
    """Return moments of frames [..., 9] as a mirrored sensor would give them."""
    right, up = (-1.0 if each else 1.0 for each in (columns, rows))
    turned = [right * up] * (moments.shape[-1] - 5)
    return moments * moments.new_tensor([1.0, right, up, right, up, *turned][: moments.shape[-1]])


def mirror_across(values: Tensor, columns: bool, rows: bool) -> Tensor:
    """Return sideways force and torsion [..., 3] of a mirrored sensor."""
    signs = [-1.0 if each else 1.0 for each in (columns, rows, columns != rows)]
    return values * torch.tensor(signs, dtype=values.dtype, device=values.device)


class DiskGroups:
    """Groups of sample files; one is in memory at a time.

    Args:
        paths: Folders of samples.
        group_size: Trials per group.
        own: Which of the files this process reads; None for all.

    Attributes:
        devices: Number of different sensors over all groups and processes.
        length: Windows that every trial is padded to.
        frames: Number of frames of each group.
    """

    def __init__(
        self,
        paths: Sequence[Path],
        group_size: int,
        own: Sequence[int] | None = None,
    ) -> None:
        chosen = list(range(len(paths)) if own is None else own)
        # One at a time is mapped: there may be more files than a process may open.
        facts = [
            (sensor_of(sample.origin, f'trial {index}'), len(sample.force), len(sample.frame_force))
            for index, sample in enumerate(load_sample(path, Sample) for path in paths)
        ]
        sensors, self._numbers = np.unique([key for key, *_ in facts], return_inverse=True)
        self.devices = len(sensors)
        self.length = max(windows for _, windows, _ in facts)
        self._paths = list(paths)
        self._groups = [chosen[i : i + group_size] for i in range(0, len(chosen), group_size)]
        self.frames = [sum(facts[i][2] for i in group) for group in self._groups]
        self._kept: tuple[int, Sequences] | None = None

    def __len__(self) -> int:
        """Return the number of groups."""
        return len(self._groups)

    def load(self, index: int) -> Sequences:
        """Return a group, from memory where it was the last.

        Raises:
            DatasetError: A file was removed or damaged meanwhile.
        """
        if self._kept is None or self._kept[0] != index:
            self._kept = None
            members = self._groups[index]
            samples = [load_sample(self._paths[i], Sample) for i in members]
            numbers = [self._numbers[i] for i in members]
            self._kept = index, stack(samples, numbers, self.length)
        return self._kept[1]


Flip = tuple[bool, bool]
"""Whether columns and rows are mirrored."""


_ENCODE_BATCH = 512
ACROSS_UNITS = (1.0, 1.0, 10.0)
"""What counts as much as a newton in the loss: sideways force [N], torsion [N mm].

Most of the time there is no torsion. With a smaller knee of the loss the network would estimate no
torsion at all.
"""


class NetworkWithGains(nn.Module):
    """FGER-Net and the gains of the sensors of the training data.

    How stiff a gel is cannot be seen: force is stiffness times the visible displacement. So each
    sensor of the training data has a gain of the normal force and one of the force across it,
    learned with the frame network and drawn towards 1, and the network learns the force on a gel of
    usual stiffness. A new sensor's gains are 1 until it is calibrated
    (`mixtac_learning.judge.metrics`).

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
        units, labelled = across.new_tensor(ACROSS_UNITS), torch.isfinite(known)
        label = torch.where(labelled, known, across.detach())
        errors = smooth_l1_loss(across / units, label / units, beta=knee, reduction='none')
        return torch.Tensor((errors * labelled).sum() / labelled.sum().clamp(min=1.0))

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


def frame_features(
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
    """Return `frame_features` of all frames, without gradients."""
    starts = range(0, len(sequences.frame_inputs), _ENCODE_BATCH)
    parts = [slice(start, start + _ENCODE_BATCH) for start in starts]
    return torch.cat([frame_features(network, sequences, part, flip) for part in parts])


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
    """Data and settings that the stages of FGER-Net share.

    Attributes:
        model: Network and gains.
        groups: Trials to train on.
        settings: Settings of the run.
        checked: Validation trials; None for none.
    """

    model: NetworkWithGains
    groups: DiskGroups
    settings: TrainingSettings
    checked: DiskGroups | None = None


class FrameStage(FgerStage):
    """Trains the frame network and the gains of the sensors on single frames."""

    def begin(self) -> None:
        """Begin with the moments alone: the convolutions learn what these leave over."""
        if self.model.network.config.reads_flow and not self.model.adapts:
            follow_moments(self.model.network, self.groups.load(0))

    def parameters(self) -> list[nn.Parameter]:
        """Return the weights that a frame's forces come from, and the gains.

        Of a trained network only the weights from its features to the normal force.
        """
        if self.model.adapts:
            return list(self.model.network.frame.head.parameters())
        return [*frame_parameters(self.model.network), self.model.log_gains]

    def updates(self) -> int:
        """Return the number of updates per epoch."""
        return sum(-(-count // self.settings.frame_batch) for count in self.groups.frames)

    def losses(self, random: torch.Generator) -> Iterator[Tensor]:
        """Yield the losses of one epoch: groups in random order, frames shuffled within each."""
        for group in torch.randperm(len(self.groups), generator=random).tolist():
            sequences = self.groups.load(group).to(self.model.device)
            labels = sequences.frame_force
            device = sequences.device[sequences.frame_trial]
            order = shuffled(len(labels), random)
            for chosen in torch.split(order, self.settings.frame_batch):
                flips, network = draw_flips(self.settings, random), self.model.network
                seen = frame_features(network, sequences, chosen, flips)
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


@torch.no_grad()
def follow_moments(network: FgerNetwork, sequences: Sequences) -> None:
    """Fit the forces of frames by the moments alone, by least squares, in place.

    Args:
        network: `NetworkWithGains.fit_scales` has been called.
        sequences: Trials to fit the constants to.
    """
    moments = (sequences.frame_moments / network.frame.spread.cpu()).double()
    first = network.config.frame_size
    heads = [(network.frame.head, [[0]], sequences.frame_force[:, None])]
    if network.config.shear:
        heads += [(network.shear.frame, [[1, 3], [2, 4]], sequences.frame_across[:, :2])]
    for head, columns, known in heads:
        labelled = torch.isfinite(known).all(1)
        inputs = torch.cat([moments[labelled][:, each] for each in columns])
        found = torch.linalg.lstsq(inputs, known[labelled].T.reshape(-1, 1).double()).solution[:, 0]
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
