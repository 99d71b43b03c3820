# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""FGER-Net in torch: the paper's Algorithm 1 over batches of sequences, with uncertainty."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn.functional import linear

from mixtac_fger.config import (
    ARCHITECTURE,
    CELL_FEATURES,
    MOMENTS,
    TURNING_WIDTHS,
    VERSION,
    FgerConfig,
    ModelError,
    map_shapes,
)
from mixtac_fger.fger_net import checked_config
from mixtac_fger.weights import Model, ModelCard, Tensors


def usual_device() -> str:
    """Return `cuda` where there is a GPU, else `cpu`."""
    return 'cuda' if torch.cuda.is_available() else 'cpu'


def count_parameters(network: nn.Module) -> int:
    """Return the number of trained parameters."""
    return sum(parameter.numel() for parameter in network.parameters())


class SequenceState(NamedTuple):
    """State carried from one stretch to the next; B sequences side by side.

    Attributes:
        hidden: LSTM output h, [B, lstm_size].
        cell: LSTM cell C, [B, lstm_size].
        history: Sums of the increments after each past window, oldest first, [L, B] in N.
        offset: Force of the latest frame less the element of `history` at the centre of its
            exposure, [B] in N; history[-1] + offset is the estimate.
        seen: f_frame of the latest frame, [B, feature_size].
    """

    hidden: Tensor
    cell: Tensor
    history: Tensor
    offset: Tensor
    seen: Tensor

    def detach(self) -> SequenceState:
        """Return the state without its gradients."""
        return SequenceState(*(part.detach() for part in self))


class FrameSlots(NamedTuple):
    """Which frame becomes available at which window.

    Attributes:
        frame: Row of the frame features, -1 where no frame becomes available, int64 [T, B].
        lag: Windows between the last estimate and the centre of the exposure, int64 [T, B].
    """

    frame: Tensor
    lag: Tensor

    def latest(self) -> Tensor:
        """Return one more than the window of the latest frame, 0 before the first, [T, B]."""
        number = torch.arange(1, len(self.frame) + 1, device=self.frame.device)[:, None]
        return torch.where(self.frame >= 0, number, 0).cummax(dim=0).values


class Course(NamedTuple):
    """Result of a stretch of T windows of B sequences.

    Attributes:
        force: Force at the end of each window [N], [T, B].
        state: State after the last window.
    """

    force: Tensor
    state: SequenceState


class ShearHead(nn.Module):
    """Sideways force and torsion of a frame; what events add is no network (`mixtac_fger.shear`).

    Args:
        config: Network configuration.

    Attributes:
        frame: From f_frame to the sideways force that a frame shows [N].
        turning: From the output of the convolutions to the torsion per moment of turning [N mm].
        unit: Factor of each axis.
        deviation: Floor, share of the value and share of the increments, by axis.
    """

    def __init__(self, config: FgerConfig) -> None:
        super().__init__()
        self.frame = nn.Linear(config.feature_size, 2)
        self.turning = nn.Linear(config.frame_size, len(TURNING_WIDTHS))
        self.unit: Tensor
        self.register_buffer('unit', torch.ones(3))
        self.deviation: Tensor
        self.register_buffer('deviation', torch.zeros(3, 3))

    def shown(self, seen: Tensor) -> Tensor:
        """Return what frames show [N, N, N mm], [..., 3], by f_frame."""
        gates = self.turning(seen[..., : self.turning.in_features])
        torsion = (seen[..., -gates.shape[-1] :] * gates).sum(-1, keepdim=True)
        return torch.cat([self.frame(seen), torsion], dim=-1)


class FrameNetwork(nn.Module):
    """Phi_f: strided convolutions and a linear layer, and moments; plus the frames-only force.

    Args:
        config: Network configuration.
    """

    def __init__(self, config: FgerConfig) -> None:
        super().__init__()
        maps = map_shapes(config)
        self.mean: Tensor
        self.scale: Tensor
        self.register_buffer('mean', torch.zeros(maps[0][2], 1, 1))
        self.register_buffer('scale', torch.ones(maps[0][2], 1, 1))
        layers: list[nn.Module] = []
        for before, after in pairwise(maps):
            layers += [nn.Conv2d(before[2], after[2], 3, stride=2, padding=1), nn.ReLU()]
        self.convolutions = nn.Sequential(*layers)
        self.project = nn.Linear(math.prod(maps[-1]), config.frame_size)
        self.head = nn.Linear(config.feature_size, 1)
        if config.reads_flow:
            self.spread: Tensor
            self.register_buffer('spread', torch.ones(MOMENTS))

    def forward(self, frames: Tensor, moments: Tensor) -> Tensor:
        """Return f_frame [N, feature_size].

        Args:
            frames: Inputs, [N, channels, rows, columns].
            moments: Of their displacement (`mixtac_fger.shear`), [N, 9]; [N, 0] without flow.
        """
        maps = self.convolutions((frames - self.mean) / self.scale)
        found = torch.relu(self.project(maps.flatten(1)))
        return torch.cat([found, moments / self.spread], dim=1) if moments.shape[1] else found

    def force(self, feature: Tensor) -> Tensor:
        """Return the frames-only force [N] (in N) by f_frame, [N, feature_size]."""
        return torch.Tensor(self.head(feature))[:, 0]


class EventNetwork(nn.Module):
    """Phi_e: a two-layer perceptron on the scaled grid features.

    Args:
        config: Network configuration.
    """

    def __init__(self, config: FgerConfig) -> None:
        super().__init__()
        self.scale: Tensor
        self.register_buffer('scale', torch.ones(CELL_FEATURES))
        self.hidden = nn.Linear(config.event_inputs, config.event_hidden)
        self.output = nn.Linear(config.event_hidden, config.event_size)

    def forward(self, features: Tensor) -> Tensor:
        """Return f_e [..., event_size] of grid features [..., rows, columns, 4]."""
        scaled = (features / self.scale).flatten(-3)
        return torch.relu(self.output(torch.relu(self.hidden(scaled))))


class FgerNetwork(nn.Module):
    """The whole network; `forward` runs a stretch of windows of B sequences.

    Args:
        config: Network configuration.
    """

    def __init__(self, config: FgerConfig) -> None:
        super().__init__()
        self.config = config
        self.frame = FrameNetwork(config)
        self.event = EventNetwork(config)
        gates = 4 * config.lstm_size
        self.gates_event = nn.Linear(config.event_size, gates)
        self.gates_force = nn.Linear(1, gates, bias=False)
        self.gates_hidden = nn.Linear(config.lstm_size, gates, bias=False)
        shortcut = config.event_size if config.event_shortcut else 0
        self.increment = perceptron(config.lstm_size + shortcut, config.mlp_size)
        if config.frame_context:
            self.context = nn.Linear(config.feature_size, config.mlp_size, bias=False)
        if config.shear:
            self.shear = ShearHead(config)
        self.deviation: Tensor
        self.register_buffer('deviation', torch.zeros(3))

    def initial_state(self, sequences: int) -> SequenceState:
        """Return the state before the first window: no force, empty memory."""
        config, device = self.config, self.gates_force.weight.device
        zeros = torch.zeros(sequences, config.lstm_size, device=device)
        history = torch.zeros(config.history_windows, sequences, device=device)
        offset = torch.zeros(sequences, device=device)
        seen = torch.zeros(sequences, config.feature_size, device=device)
        return SequenceState(zeros, zeros, history, offset, seen)

    def forward(
        self,
        event_features: Tensor,
        frames: Tensor,
        slots: FrameSlots,
        state: SequenceState,
    ) -> Course:
        """Run T windows of B sequences.

        Args:
            event_features: Grid features, [T, B, grid rows, grid columns, 4].
            frames: f_frame of all frames that `slots` names, [N, feature_size].
            slots: When which frame becomes available.
            state: State before the first window.
        """
        events = self.event(event_features)
        drive = self.gates_event(events)
        direct, of_state = self._direct(events)
        features = torch.cat([state.seen[None], frames[slots.frame.clamp(min=0)]])
        latest = slots.latest()[..., None].expand(-1, -1, features.shape[-1])
        seen = features.gather(0, latest)
        if self.config.frame_context:
            direct = direct + self.context(seen)
        arrivals = (slots.frame >= 0).any(dim=1).tolist()
        # Cut once: the gradient of an index is as large as what it cuts from.
        shown, drives, directs = (
            each.unbind(0) for each in (self.frame.head(features[1:])[..., 0], drive, direct)
        )
        hidden, cell, offset = state.hidden, state.cell, state.offset
        past = list(state.history.unbind(0))
        forces = []
        for window, arrival in enumerate(arrivals):
            if arrival:
                here = FrameSlots(slots.frame[window], slots.lag[window])
                corrected = shown[window] - self._exposed(past, here)
                offset = torch.where(here.frame >= 0, corrected, offset)
            estimate = (past[-1] + offset)[:, None]
            gates = drives[window] + self.gates_force(estimate) + self.gates_hidden(hidden)
            keep_in, keep_old, fresh, keep_out = gates.chunk(4, dim=1)
            cell = torch.sigmoid(keep_old) * cell + torch.sigmoid(keep_in) * torch.tanh(fresh)
            hidden = torch.sigmoid(keep_out) * torch.tanh(cell)
            middle = torch.relu(directs[window] + linear(hidden, of_state))
            past.append(past[-1] + self.increment[2](middle)[:, 0])
            forces.append(past[-1] + offset)
        history = torch.stack(past[-self.config.history_windows :])
        last = SequenceState(hidden, cell, history, offset, seen[-1])
        return Course(torch.stack(forces), last)

    def _direct(self, events: Tensor) -> tuple[Tensor, Tensor]:
        """Split the hidden layer of MLP_df: the loop over windows costs most of the time.

        Returns:
            What events and bias contribute in each window, [T, B, mlp_size], and the weights of
            the recurrent state, [mlp_size, lstm_size].
        """
        weight, bias = (
            self.increment.get_parameter('0.weight'),
            self.increment.get_parameter('0.bias'),
        )
        size = self.config.lstm_size
        direct = bias.expand(*events.shape[:-1], -1)
        if self.config.event_shortcut:
            direct = linear(events, weight[:, size:], bias)
        return direct, weight[:, :size]

    def _exposed(self, past: list[Tensor], slots: FrameSlots) -> Tensor:
        """Return the sum of the increments [B] at the centre of the exposure of the frames."""
        depth = 1 + min(int(slots.lag.max()), self.config.history_windows - 1)
        recent = torch.stack(past[-depth:])
        row = (depth - 1 - slots.lag).clamp(0, depth - 1)
        return recent.gather(0, row[None])[0]


def perceptron(inputs: int, hidden: int) -> nn.Sequential:
    """Return a perceptron with one hidden layer and one output."""
    return nn.Sequential(nn.Linear(inputs, hidden), nn.ReLU(), nn.Linear(hidden, 1))


def arrays_of(network: nn.Module) -> Tensors:
    """Return the weights and statistics of a network as arrays by name."""
    return {name: tensor.detach().cpu().numpy() for name, tensor in network.state_dict().items()}


def load_arrays(network: nn.Module, tensors: Tensors) -> None:
    """Copy arrays into a network.

    Raises:
        ModelError: Names or shapes do not fit.
    """
    # A copy: torch refuses or warns about arrays that cannot be written to.
    state = {name: torch.from_numpy(tensor.copy()) for name, tensor in tensors.items()}
    try:
        network.load_state_dict(state)
    except RuntimeError as error:
        raise ModelError(f'the weights do not fit: {" ".join(str(error).split())}') from error


def network_of(model: Model) -> FgerNetwork:
    """Return the network of an FGER-Net model, in evaluation mode on the CPU.

    Raises:
        ModelError: The model is of another architecture, or its tensors do not fit.
    """
    network = FgerNetwork(checked_config(model))
    load_arrays(network, model.tensors)
    return network.eval()


def model_of(network: FgerNetwork, card: ModelCard) -> Model:
    """Return the content of a weight file of a network."""
    return Model(ARCHITECTURE, VERSION, network.config.to_dict(), card, arrays_of(network))
