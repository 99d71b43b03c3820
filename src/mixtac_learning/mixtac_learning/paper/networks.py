# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The paper's networks in torch: FGER-Net as published, and its three baselines."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise, product
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn.functional import max_pool2d

from mixtac_fger.config import ConfigError, ModelError
from mixtac_fger.weights import Model, ModelCard
from mixtac_learning.network import arrays_of, load_arrays, perceptron
from mixtac_learning.paper.config import PaperConfig


@dataclass(frozen=True, slots=True, eq=False)
class SegmentBatch:
    """B stretches of T windows with the frames that arrive in them.

    Attributes:
        points: Events of all windows, [E, 4]; see `PointEncoder`.
        packet: Window of each event, t * B + b, int64 [E].
        frames: The frames, [N, frame_channels, rows, columns], see `FrameBackbone`; or f_frame,
            [N, channels], for FGER-Net where it is known already.
        event_frames: ln(1 + count) of ON and OFF events between each frame and the one before, [N,
            2, rows, columns]; empty unless the model reads them.
        slots: Frame that arrives in each window, -1 for none, int64 [T, B].
        before: Frame that is the latest before the first window, -1 for none, int64 [B].
        force: Label at the end of each window [N], [T, B].
    """

    points: Tensor
    packet: Tensor
    frames: Tensor
    event_frames: Tensor
    slots: Tensor
    before: Tensor
    force: Tensor

    def to(self, device: torch.device) -> SegmentBatch:
        """Return the batch on a device."""
        return SegmentBatch(*(getattr(self, name).to(device) for name in self.__slots__))


class PaperState(NamedTuple):
    """State that is carried from stretch to stretch.

    Attributes:
        hidden: LSTM output [B, lstm_size].
        cell: LSTM cell [B, lstm_size].
        force: Estimate [B] in N.
        feature: Feature of the latest frame [B, channels].
        seen: Whether there is one, bool [B].
        withheld: Part of `force` that is not given out yet [B] in N (`spread`).
        share: What each window gives out of it [B] in N.
    """

    hidden: Tensor
    cell: Tensor
    force: Tensor
    feature: Tensor
    seen: Tensor
    withheld: Tensor
    share: Tensor


POINT_SIZE = 4
"""Numbers per event: x, y, time in the packet, polarity; each within -1 .. 1."""


class Scale(nn.Module):
    """Brings values to zero mean and unit spread by constants that belong to the weights.

    The average over an image hardly moves: a feature varies by some thousandths of its mean over
    all forces. Without this, what follows takes tens of epochs to find what varies.

    Args:
        size: Number of channels.

    Attributes:
        follows: Whether values are scaled by their own mean and spread in training, which the
            constants follow: where what computes them learns.
    """

    def __init__(self, size: int) -> None:
        super().__init__()
        self.mean: Tensor
        self.deviation: Tensor
        self.register_buffer('mean', torch.zeros(size))
        self.register_buffer('deviation', torch.ones(size))
        self.follows = False

    def reset(self) -> None:
        """Leave values as they are."""
        self.mean.zero_()
        self.deviation.fill_(1.0)

    def fit(self, values: Tensor, part: float = 1.0) -> tuple[Tensor, Tensor]:
        """Move the constants towards those of values [n, size], which are returned, by a part.

        The spread of channels that are constant is 1.
        """
        mean, deviation = values.mean(0), values.std(0)
        varies = deviation > SAME * mean.abs() + SAME
        deviation = torch.where(varies, deviation, torch.ones_like(deviation))
        with torch.no_grad():
            self.mean.lerp_(mean, part)
            self.deviation.lerp_(deviation, part)
        return mean, deviation

    def forward(self, values: Tensor) -> Tensor:
        """Return values [n, size] scaled; in training by their own mean where `follows` is set."""
        values = values.float()
        mean, deviation = self.mean, self.deviation
        if self.follows and self.training and len(values) > 1:
            mean, deviation = self.fit(values, _FOLLOWED)
        return (values - mean) / deviation


_AT_RANDOM = 0.1
"""Part of the usual initial weights that is left where channels begin as cells."""
_BY_TIME = 0.5
"""How much more a channel begins to tell of the last event of a packet than of the first."""
_FOLLOWED = 0.05
"""Part of the way that the constants of a scale go in an update."""
SAME = 1e-6
"""Relative spread below which a channel is constant."""


def _grid(ramps: int, channels: int) -> tuple[int, int]:
    """Return how many columns and rows of cells so many ramps and channels can make."""
    rows = max(math.isqrt(channels // 2), 1)
    columns = max(channels // 2 // rows, 1)
    while 2 * (columns + rows - 2) + 3 > ramps and max(columns, rows) > 1:
        columns, rows = (columns - 1, rows) if columns >= rows else (columns, rows - 1)
    return columns, rows


_GROUPS = 8
"""Groups of channels that are normalised together."""


def _norm(config: PaperConfig) -> nn.Module:
    """Return a normalisation of the frame network's maps; both kinds have as many parameters."""
    if config.norm == 'batch':
        return nn.BatchNorm2d(config.channels)
    return nn.GroupNorm(math.gcd(_GROUPS, config.channels), config.channels)


class ResidualBlock(nn.Module):
    """Two 3 x 3 convolutions with a bypass (He et al. 2016).

    Args:
        config: Shapes.
    """

    def __init__(self, config: PaperConfig) -> None:
        super().__init__()
        channels = config.channels
        self.first = nn.Conv2d(channels, channels, 3, padding=1, bias=False)
        self.first_norm = _norm(config)
        self.second = nn.Conv2d(channels, channels, 3, padding=1, bias=False)
        self.second_norm = _norm(config)

    def forward(self, maps: Tensor) -> Tensor:
        """Return maps of the same shape, [N, channels, rows, columns]."""
        inner = torch.relu(self.first_norm(self.first(maps)))
        return torch.relu(maps + self.second_norm(self.second(inner)))


DARK = 1e-3
"""Smallest intensity whose logarithm is taken; the converter's lowest bit."""


class FrameBackbone(nn.Module):
    """Phi_f: stem and first stage of a residual network, then the average over the image.

    Args:
        config: Shapes.
    """

    def __init__(self, config: PaperConfig) -> None:
        super().__init__()
        self._relative = config.light != 'intensity'
        channels = config.channels
        self.input_scale, self.scale = Scale(config.frame_channels), Scale(channels)
        self.stem = nn.Sequential(
            nn.Conv2d(config.frame_channels, channels, 7, stride=2, padding=3, bias=False),
            _norm(config),
            nn.ReLU(),
            nn.MaxPool2d(3, stride=2, padding=1),
        )
        self.stage = nn.Sequential(*(ResidualBlock(config) for _ in range(config.blocks)))

    def seen(self, frames: Tensor) -> Tensor:
        """Return the frames as the network sees them, before they are scaled.

        Args:
            frames: Intensities of 0 to 1, or their ratio to the reference, and what else there is
                of the reference, [N, channels, rows, columns].

        Returns:
            The same with the channels last.
        """
        frames = frames.movedim(1, -1)
        if not self._relative:
            return frames
        logs = torch.log(frames[..., :1].clamp(min=DARK))
        logs = logs - logs.mean((1, 2), keepdim=True)
        return torch.cat([logs, frames[..., 1:]], -1)

    def forward(self, frames: Tensor) -> Tensor:
        """Return f_frame [N, channels] of frames as `seen` takes them, in full precision.

        Features vary by no more than bfloat16 resolves.
        """
        with torch.autocast(frames.device.type, enabled=False):
            inputs = self.input_scale(self.seen(frames.float())).movedim(-1, 1)
            maps = self.stage(self.stem(inputs.contiguous(memory_format=torch.channels_last)))
            return torch.Tensor(self.scale(maps.mean((2, 3))))


class PointEncoder(nn.Module):
    """Phi_e: a perceptron on every event, then the maximum over each packet.

    Args:
        config: Shapes.
    """

    def __init__(self, config: PaperConfig) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        width = POINT_SIZE
        for size in config.event_widths:
            layers += [nn.Linear(width, size), nn.ReLU()]
            width = size
        # The maximum begins at zero, which is the last rectifier.
        self.layers = nn.Sequential(*layers[:-1])
        self.size = width
        self.scale = Scale(width)
        if len(config.event_widths) > 1:
            self._begin_with_cells()

    @torch.no_grad()
    def _begin_with_cells(self) -> None:
        """Let channels begin as one cell of the sensor and one polarity each.

        A maximum tells only whether there was an event, so that a channel has to be of one place.
        With the usual initial weights every ramp is as wide as the sensor. The value grows with
        the time of the latest event, which is the later the more there are.
        """
        first, second = (self.layers.get_submodule(name) for name in ('0', '2'))
        ramps, ramp_bias = first.get_parameter('weight'), first.get_parameter('bias')
        sums, sum_bias = second.get_parameter('weight'), second.get_parameter('bias')
        cells = _grid(len(ramps), len(sums))
        # Ramps up and down from each border between cells; polarity ON, OFF; time.
        used = 3
        beyond: list[int] = []
        below: list[int] = []
        ramps[:3], ramp_bias[:3] = 0.0, 0.0
        ramps[0, 3], ramps[1, 3], ramps[2, 2] = 1.0, -1.0, 1.0
        for axis, count in enumerate(cells):
            borders = torch.linspace(-1.0, 1.0, count + 1)[1:-1]
            for starts, sign in ((beyond, 1.0), (below, -1.0)):
                rows = slice(used, used + count - 1)
                ramps[rows], ramp_bias[rows] = 0.0, -sign * borders
                ramps[rows, axis] = sign
                starts.append(used)
                used += count - 1
        sums.mul_(_AT_RANDOM)
        for channel, (column, row, other) in enumerate(
            product(range(cells[0]), range(cells[1]), (0, 1))
        ):
            sums[channel, :used], sum_bias[channel] = 0.0, 1.0
            sums[channel, 2] = _BY_TIME
            sums[channel, other] = -2.0
            for axis, place in enumerate((column, row)):
                if place < cells[axis] - 1:
                    sums[channel, beyond[axis] + place] = -float(cells[axis])
                if place:
                    sums[channel, below[axis] + place - 1] = -float(cells[axis])

    def forward(self, points: Tensor, packet: Tensor, packets: int) -> Tensor:
        """Return f_e [packets, size]; an empty packet has the maximum zero, scaled.

        Args:
            points: All events of all packets, [E, 4].
            packet: Which packet each belongs to, int64 [E].
            packets: How many packets.
        """
        features = self.layers(points)
        empty = features.new_zeros(packets, self.size)
        index = packet[:, None].expand(-1, self.size)
        pooled = empty.scatter_reduce(0, index, features, 'amax', include_self=True)
        return torch.Tensor(self.scale(pooled))


class SparseBlock(nn.Module):
    """A convolution whose output exists only where its input does, then a step to half the size.

    The convolution is of the submanifold kind (Graham et al. 2018): a pixel without events stays
    empty, whatever its neighbours hold. It is computed on the dense grid with a mask, which gives
    the same numbers as a list of pixels would. The mean and variance of the normalisation are
    those of the pixels that exist.

    Args:
        inputs: Channels of the input.
        outputs: Channels of the output.
    """

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.convolution = nn.Conv2d(inputs, outputs, 3, padding=1, bias=False)
        self.norm = nn.BatchNorm1d(outputs)

    def forward(self, maps: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
        """Return maps and mask at half the size.

        Args:
            maps: [N, inputs, rows, columns], zero where the mask is.
            mask: bool [N, 1, rows, columns].
        """
        dense = self.convolution(maps)
        active = mask[:, 0]
        values = dense.permute(0, 2, 3, 1)[active]
        if len(values) > 1 or not self.training:
            values = self.norm(values)
        values = torch.relu(values)
        out = torch.zeros_like(dense).permute(0, 2, 3, 1).contiguous()
        out[active] = values.to(out.dtype)
        # Values are at least zero, so that empty pixels do not win the maximum.
        pooled = max_pool2d(out.permute(0, 3, 1, 2), 2, ceil_mode=True)
        return pooled, max_pool2d(mask.to(dense.dtype), 2, ceil_mode=True) > 0


class SparseBackbone(nn.Module):
    """Sparse blocks, then the mean over the pixels that are left.

    Args:
        inputs: Channels of the event frames.
        channels: Channels after each block.
    """

    def __init__(self, inputs: int, channels: tuple[int, ...]) -> None:
        super().__init__()
        widths = (inputs, *channels)
        self.scale = Scale(channels[-1])
        self.blocks = nn.ModuleList(SparseBlock(a, b) for a, b in pairwise(widths))

    def forward(self, event_frames: Tensor) -> Tensor:
        """Return features [N, channels] of event frames [N, inputs, rows, columns]."""
        maps, mask = event_frames, event_frames.abs().amax(1, keepdim=True) > 0
        for block in self.blocks:
            maps, mask = block(maps, mask)
        count = mask.sum((2, 3)).clamp(min=1)
        return torch.Tensor(self.scale(maps.sum((2, 3)) / count))


class EventRecurrence(nn.Module):
    """Lines 4 to 9 of Algorithm 1: events to increments of the force.

    Increments are in a unit that belongs to the weights, of the size of a change within a window
    [N]: the perceptron would otherwise begin with increments a hundred times as large as true ones.

    Args:
        config: Shapes.
    """

    def __init__(self, config: PaperConfig) -> None:
        super().__init__()
        self.encoder = PointEncoder(config)
        self.lstm = nn.LSTMCell(self.encoder.size + 1, config.lstm_size)
        self.increment = perceptron(config.lstm_size, config.increment_size)
        self.unit: Tensor
        self.register_buffer('unit', torch.ones(()))

    def features(self, batch: SegmentBatch) -> Tensor:
        """Return f_e of all windows, [T, B, size]."""
        windows, sequences = batch.slots.shape
        encoded = self.encoder(batch.points, batch.packet, windows * sequences)
        return torch.Tensor(encoded.view(windows, sequences, -1))

    def step(self, features: Tensor, state: PaperState) -> PaperState:
        """Return the state after one window with features [B, size]."""
        inputs = torch.cat([features, state.force[:, None]], 1)
        hidden, cell = self.lstm(inputs, (state.hidden, state.cell))
        force = state.force + self.unit * self.increment(hidden)[:, 0]
        return state._replace(hidden=hidden, cell=cell, force=force)


class RecurrentModel(nn.Module):
    """A network with the recurrence."""

    config: PaperConfig
    recurrence: EventRecurrence

    def initial_state(self, sequences: int) -> PaperState:
        """Return the state before any event: no force."""
        like = self.recurrence.lstm.weight_ih
        zeros = like.new_zeros(sequences, self.config.lstm_size)
        feature = like.new_zeros(sequences, self.config.channels)
        seen = torch.zeros(sequences, dtype=torch.bool, device=like.device)
        force, withheld, share = like.new_zeros(3, sequences)
        return PaperState(zeros, zeros.clone(), force, feature, seen, withheld, share)


class EventsOnly(RecurrentModel):
    """The recurrence alone: no frame reaches it, neither as input nor through a gradient.

    Args:
        config: Shapes.
    """

    def __init__(self, config: PaperConfig) -> None:
        super().__init__()
        self.config = config
        self.recurrence = EventRecurrence(config)

    def forward(self, batch: SegmentBatch, state: PaperState) -> tuple[Tensor, PaperState]:
        """Return the force [N] at the end of each window, [T, B], and the state after the last."""
        events, forces = self.recurrence.features(batch), []
        with torch.autocast(events.device.type, enabled=False):
            for features in events:
                state = self.recurrence.step(features, state)
                forces.append(state.force)
        return torch.stack(forces), state


class FgerPaper(RecurrentModel):
    """FGER-Net.

    The estimate that is carried on is corrected once per cycle, by the frame whose arrival ends
    it. `PaperConfig.correction` applies to what is given out, in training as in use. With
    `continuous` every window's estimate is corrected by the latest frame. That correction is not
    carried on: fed back 500 times a second it is unstable. With `spread` each correction, after
    the first, is given out in equal parts over the windows of the next cycle, so that the force
    does not jump at frames.

    Args:
        config: Shapes.
    """

    def __init__(self, config: PaperConfig) -> None:
        super().__init__()
        self.config = config
        self.frame = FrameBackbone(config)
        self.recurrence = EventRecurrence(config)
        self.correction = perceptron(1 + config.channels, config.correction_size)
        self.begin_at_frames()

    @torch.no_grad()
    def begin_at_frames(self) -> None:
        """Let the correction be minus the estimate, by two hidden units, and what frames say.

        A corrected force is then that of a frame alone; with the usual initial weights something
        of the estimate is left in it. Learning the other units from estimates of zero leaves these
        two to weight decay, after which this is called again.
        """
        weights = ('0.weight', '0.bias', '2.weight')
        ramps, bias, sums = (self.correction.get_parameter(name) for name in weights)
        ramps[:, 0], ramps[:2], bias[:2] = 0.0, 0.0, 0.0
        ramps[0, 0], ramps[1, 0] = 1.0, -1.0
        sums[0, 0], sums[0, 1] = -1.0, 1.0

    def forward(self, batch: SegmentBatch, state: PaperState) -> tuple[Tensor, PaperState]:
        """Return the force [N] at the end of each window, [T, B], and the state after the last."""
        known = batch.frames.dim() == 2
        frames = batch.frames if known else self.frame(batch.frames)
        events = self.recurrence.features(batch)
        if len(frames):
            state = _see(state, frames, batch.before)
        arrivals = (batch.slots >= 0).any(1).tolist()
        forces = []
        with torch.autocast(frames.device.type, enabled=False):  # sums of small increments
            for features, slots, arrives in zip(events, batch.slots, arrivals, strict=True):
                given, state = self.window(features, frames, slots, state, arrives=arrives)
                forces.append(given)
        return torch.stack(forces), state

    def window(
        self,
        features: Tensor,
        frames: Tensor,
        slots: Tensor,
        state: PaperState,
        *,
        arrives: bool,
    ) -> tuple[Tensor, PaperState]:
        """Return the force [N] at the end of one window, [B], and the state after it.

        Args:
            features: f_e of the window, [B, size].
            frames: f_frame of frames, [N, channels].
            slots: Frame that arrives in the window, -1 for none, int64 [B].
            state: Before the window.
            arrives: Whether any frame arrives.
        """
        state = self.recurrence.step(features, state)
        fresh = slots >= 0
        if arrives:
            known, before = state.seen, state.force
            state = _see(state, frames, slots)
            force = torch.where(fresh, self.corrected(state.force, state.feature), state.force)
            state = state._replace(force=force)
            if self.config.correction == 'spread':
                withheld = state.withheld + torch.where(known, force - before, 0.0)
                windows = CYCLE_US // self.config.window_us
                share = torch.where(fresh, withheld / windows, state.share)
                state = state._replace(withheld=withheld, share=share)
        given = state.force
        if self.config.correction == 'continuous':
            corrected = self.corrected(given, state.feature)
            given = torch.where(state.seen & ~fresh, corrected, given)
        elif self.config.correction == 'spread':
            more = state.withheld.abs() > state.share.abs()
            withheld = torch.where(more, state.withheld - state.share, 0.0)
            state = state._replace(withheld=withheld)
            given = state.force - withheld
        return given, state

    def features(self, frames: Tensor, event_frames: Tensor) -> Tensor:  # noqa: ARG002
        """Return f_frame of frames, [N, channels]; the events are not used."""
        return torch.Tensor(self.frame(frames))

    def force_of(self, features: Tensor) -> Tensor:
        """Return the correction of an estimate of zero by frames of f_frame [N] (in N)."""
        return self.corrected(torch.zeros_like(features[:, 0]), features)

    def corrected(self, force: Tensor, feature: Tensor) -> Tensor:
        """Return forces [N] corrected by frames of features [N, channels] [N]."""
        return force + torch.Tensor(self.correction(torch.cat([force[:, None], feature], 1))[:, 0])


def _see(state: PaperState, frames: Tensor, slots: Tensor) -> PaperState:
    fresh = slots >= 0
    feature = torch.where(fresh[:, None], frames[slots.clamp(min=0)], state.feature)
    return state._replace(feature=feature, seen=state.seen | fresh)


class FrameModel(nn.Module):
    """A network with one force per frame, held until the next.

    Args:
        config: Shapes.
    """

    def __init__(self, config: PaperConfig) -> None:
        super().__init__()
        self.config = config
        self.frame = FrameBackbone(config)
        more = config.sparse_channels[-1] if config.model == 'fusion' else 0
        self.head = perceptron(config.channels + more, config.correction_size)

    def initial_state(self, sequences: int) -> PaperState:
        """Return the state before the first frame: no force."""
        device = next(self.parameters()).device
        none = torch.zeros(sequences, 0, device=device)
        seen = torch.zeros(sequences, dtype=torch.bool, device=device)
        force, withheld, share = torch.zeros(3, sequences, device=device)
        return PaperState(none, none, force, none, seen, withheld, share)

    def features(self, frames: Tensor, event_frames: Tensor) -> Tensor:
        """Return what the head reads of each frame, [N, size]; inputs as in `SegmentBatch`."""
        raise NotImplementedError

    def force_of(self, features: Tensor) -> Tensor:
        """Return the force [N] of each frame, [N], by what `features` returns."""
        return torch.Tensor(self.head(features)[:, 0])

    def forward(self, batch: SegmentBatch, state: PaperState) -> tuple[Tensor, PaperState]:
        """Return the force [N] at the end of each window, [T, B], and the state after the last."""
        own = batch.force.new_zeros(1)
        if len(batch.frames):
            own = self.force_of(self.features(batch.frames, batch.event_frames))
        known = torch.where(batch.before >= 0, own[batch.before.clamp(min=0)], state.force)
        forces = []
        for slots in batch.slots:
            known = torch.where(slots >= 0, own[slots.clamp(min=0)], known)
            forces.append(known)
        return torch.stack(forces), state._replace(force=known)


class FramesOnly(FrameModel):
    """The frame feature fed directly into a regression head."""

    def features(self, frames: Tensor, event_frames: Tensor) -> Tensor:  # noqa: ARG002
        """Return the frame feature; the events are not used."""
        return torch.Tensor(self.frame(frames))


class FeatureFusion(FrameModel):
    """Two convolutional networks side by side, their features concatenated, a perceptron on top.

    Args:
        config: Shapes.
    """

    def __init__(self, config: PaperConfig) -> None:
        super().__init__(config)
        self.events = SparseBackbone(2, config.sparse_channels)

    def features(self, frames: Tensor, event_frames: Tensor) -> Tensor:
        """Return the features of frames and events side by side."""
        return torch.cat([self.frame(frames), self.events(event_frames)], 1)


PaperNetwork = FgerPaper | EventsOnly | FrameModel
CYCLE_US = 40_000
"""From frame to frame at the paper's 25 Hz."""
_CLASSES: dict[str, type[FgerPaper | EventsOnly | FramesOnly | FeatureFusion]] = {
    'fger': FgerPaper,
    'events': EventsOnly,
    'frames': FramesOnly,
    'fusion': FeatureFusion,
}


def build(config: PaperConfig) -> PaperNetwork:
    """Return a network with fresh weights."""
    return _CLASSES[config.model](config)


PAPER_ARCHITECTURE = 'fger_paper'
PAPER_VERSION = 3
_REMEDY = 'train one with "mixtac train fger_paper"'


def paper_model_of(network: PaperNetwork, card: ModelCard) -> Model:
    """Return the content of a weight file of one of the paper's networks."""
    config = network.config.to_dict()
    return Model(PAPER_ARCHITECTURE, PAPER_VERSION, config, card, arrays_of(network))


def paper_network_of(model: Model) -> PaperNetwork:
    """Return the network of a model, in evaluation mode on the CPU.

    Raises:
        ModelError: The model is of another architecture or version, or its tensors do not fit.
    """
    found = (model.architecture, model.version)
    if found != (PAPER_ARCHITECTURE, PAPER_VERSION):
        raise ModelError(
            f'the weights are of {found[0]} version {found[1]}, but {PAPER_ARCHITECTURE} version'
            f' {PAPER_VERSION} is needed',
            remedy=_REMEDY,
        )
    try:
        network = build(PaperConfig.from_dict(model.config))
    except (ConfigError, ValueError, TypeError) as error:
        raise ModelError(
            f'the configuration of the weights cannot be used ({error})', remedy=_REMEDY
        ) from error
    load_arrays(network, model.tensors)
    return network.eval()


def one_cycle(config: PaperConfig) -> SegmentBatch:
    """Return one cycle at full load: a frame, and packets with the most events that are read."""
    windows, rows, columns = CYCLE_US // config.window_us, *config.frame_shape
    slots = torch.full((windows, 1), -1)
    slots[-1] = 0
    return SegmentBatch(
        points=torch.rand(windows * config.events_per_packet, 4),
        packet=torch.arange(windows).repeat_interleave(config.events_per_packet),
        frames=torch.rand(1, config.frame_channels, rows, columns),
        event_frames=torch.rand(1, 2, rows, columns),
        slots=slots,
        before=torch.tensor([-1]),
        force=torch.zeros(windows, 1),
    )


def operations_per_cycle(config: PaperConfig) -> int:
    """Return floating-point operations (2 per multiply-add) of one cycle at full load.

    As torch counts them: without normalisation, activations and pooling, and with sparse
    convolutions as if every pixel held events.
    """
    from torch.utils.flop_counter import FlopCounterMode

    network = build(config).train()
    with torch.no_grad(), FlopCounterMode(display=False) as counter:
        network(one_cycle(config), network.initial_state(1))
    return int(counter.get_total_flops())
