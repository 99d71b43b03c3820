# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The paper's networks in torch: FGER-Net as published, and its three baselines."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import NamedTuple

import torch
from torch import Tensor, nn

from mixtac_fger.config import ModelError
from mixtac_fger.weights import Model, ModelCard
from mixtac_learning.network import arrays_of, load_arrays, perceptron
from mixtac_learning.paper.config import PaperConfig
from mixtac_learning.paper.layers import FrameBackbone, PointEncoder, SparseBackbone


@dataclass(frozen=True, slots=True, eq=False)
class SegmentBatch:
    """B stretches of T windows with the frames that arrive in them.

    Attributes:
        points: Events of all windows, [E, 4]; see `PointEncoder`.
        packet: Window of each event, t * B + b, int64 [E].
        frames: The frames, [N, 1, rows, columns], see `FrameBackbone`; or f_frame,
            [N, channels], where it is known already.
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
        withheld: Part of `force` that is not published yet [B] in N.
        share: Part of it that each window publishes [B] in N.
    """

    hidden: Tensor
    cell: Tensor
    force: Tensor
    feature: Tensor
    seen: Tensor
    withheld: Tensor
    share: Tensor


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

    def forward(self, batch: SegmentBatch, state: PaperState) -> tuple[Tensor, PaperState]:
        """Return the force [N] at the end of each window, [T, B], and the state after the last."""
        events, forces = self.features(batch), []
        with torch.autocast(events.device.type, enabled=False):
            for features in events:
                state = self.step(features, state)
                forces.append(state.force)
        return torch.stack(forces), state


class Network(nn.Module):
    """One of the networks.

    Args:
        config: Shapes.
    """

    def __init__(self, config: PaperConfig) -> None:
        super().__init__()
        self.config = config

    def initial_state(self, sequences: int) -> PaperState:
        """Return the state before any event or frame: no force."""
        like = next(self.parameters())
        hidden, cell = like.new_zeros(2, sequences, self.config.lstm_size)
        feature = like.new_zeros(sequences, self.config.channels)
        seen = torch.zeros(sequences, dtype=torch.bool, device=like.device)
        force, withheld, share = like.new_zeros(3, sequences)
        return PaperState(hidden, cell, force, feature, seen, withheld, share)


class EventsOnly(Network):
    """The recurrence alone: no frame reaches it, neither as input nor through a gradient.

    Args:
        config: Shapes.
    """

    def __init__(self, config: PaperConfig) -> None:
        super().__init__(config)
        self.recurrence = EventRecurrence(config)

    def forward(self, batch: SegmentBatch, state: PaperState) -> tuple[Tensor, PaperState]:
        """Return the force [N] at the end of each window, [T, B], and the state after the last."""
        found: tuple[Tensor, PaperState] = self.recurrence(batch, state)
        return found


class FgerPaper(Network):
    """FGER-Net.

    The estimate that is carried on is corrected once per cycle, by the frame whose arrival ends
    it. Each correction, after the first, is published in equal parts over the windows of the next
    cycle, so that the force does not jump at frames, in training as in use.

    Args:
        config: Shapes.
    """

    def __init__(self, config: PaperConfig) -> None:
        super().__init__(config)
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
            withheld = state.withheld + torch.where(known, force - before, 0.0)
            windows = CYCLE_US // self.config.window_us
            share = torch.where(fresh, withheld / windows, state.share)
            state = state._replace(force=force, withheld=withheld, share=share)
        more = state.withheld.abs() > state.share.abs()
        withheld = torch.where(more, state.withheld - state.share, 0.0)
        return state.force - withheld, state._replace(withheld=withheld)

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


class FrameModel(Network):
    """A network with one force per frame, held until the next.

    Frames only: the frame feature goes directly into a regression head. Feature level fusion: two
    convolutional networks side by side, their features concatenated, a perceptron on top.

    Args:
        config: Shapes.
    """

    def __init__(self, config: PaperConfig) -> None:
        super().__init__(config)
        self.frame = FrameBackbone(config)
        more = config.sparse_channels[-1] if config.model == 'fusion' else 0
        self.head = perceptron(config.channels + more, config.correction_size)
        if config.model == 'fusion':
            self.events = SparseBackbone(2, config.sparse_channels)

    def features(self, frames: Tensor, event_frames: Tensor) -> Tensor:
        """Return the input of the head from each frame, [N, size]; inputs as in `SegmentBatch`."""
        seen = frames if frames.dim() == 2 else torch.Tensor(self.frame(frames))
        if self.config.model == 'fusion':
            return torch.cat([seen, self.events(event_frames)], 1)
        return seen

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


PaperNetwork = FgerPaper | EventsOnly | FrameModel
CYCLE_US = 40_000
"""From frame to frame at the paper's 25 Hz."""


def build(config: PaperConfig) -> PaperNetwork:
    """Return a network with fresh weights."""
    if config.model == 'fger':
        return FgerPaper(config)
    return EventsOnly(config) if config.model == 'events' else FrameModel(config)


PAPER_ARCHITECTURE = 'fger_paper'
PAPER_VERSION = 3


def paper_model_of(network: PaperNetwork, card: ModelCard) -> Model:
    """Return the content of a weight file of one of the paper's networks."""
    config = asdict(network.config)
    return Model(PAPER_ARCHITECTURE, PAPER_VERSION, config, card, arrays_of(network))


def paper_network_of(model: Model) -> PaperNetwork:
    """Return the network of a model, in evaluation mode on the CPU.

    Raises:
        ModelError: The model is of another architecture or version, or its tensors do not fit.
        ConfigError: Its configuration is impossible.
    """
    found = (model.architecture, model.version)
    if found != (PAPER_ARCHITECTURE, PAPER_VERSION):
        raise ModelError(
            f'the weights are of {found[0]} version {found[1]}, but {PAPER_ARCHITECTURE} version'
            f' {PAPER_VERSION} is needed',
            remedy='train one with "mixtac train fger_paper"',
        )
    network = build(PaperConfig.from_dict(model.config))
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
        frames=torch.rand(1, 1, rows, columns),
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
