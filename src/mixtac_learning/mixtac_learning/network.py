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
    HIGHEST_LOG_DEVIATION,
    LOWEST_LOG_DEVIATION,
    VERSION,
    FgerConfig,
    ModelError,
    map_shapes,
)
from mixtac_fger.fger_net import checked_config
from mixtac_fger.weights import Model, ModelCard, Tensors


class DeviationHead(nn.Module):
    """Standard deviation of a force, from the recurrent state and the force itself.

    Args:
        state_size: Size of the recurrent state h.
        width: Width of the hidden layer.

    Attributes:
        scale: Factor that makes plus or minus one deviation cover 68.3 % of held-out windows.
    """

    def __init__(self, state_size: int, width: int) -> None:
        super().__init__()
        self.hidden = nn.Linear(state_size + 1, width)
        self.output = nn.Linear(width, 1)
        self.scale: Tensor
        self.register_buffer('scale', torch.ones(1))

    def log_deviation(self, hidden: Tensor, force: Tensor) -> Tensor:
        """Return the logarithm of the uncalibrated deviation [log N], [...].

        Args:
            hidden: Recurrent state after a window, [..., state_size].
            force: Force at the end of the window [N], [...].
        """
        inputs = torch.cat([hidden, force[..., None]], dim=-1)
        raw = self.output(torch.relu(self.hidden(inputs)))[..., 0]
        return torch.Tensor(raw.clamp(LOWEST_LOG_DEVIATION, HIGHEST_LOG_DEVIATION))

    def forward(self, hidden: Tensor, force: Tensor) -> Tensor:
        """Return the calibrated standard deviation [N], arguments as in `log_deviation`."""
        return self.scale * self.log_deviation(hidden, force).exp()


def count_parameters(network: nn.Module) -> int:
    """Return the number of trained parameters."""
    return sum(parameter.numel() for parameter in network.parameters())


class SequenceState(NamedTuple):
    """State carried from one stretch to the next; B sequences side by side.

    Attributes:
        hidden: LSTM output h, [B, lstm_size].
        cell: LSTM cell C, [B, lstm_size].
        history: Sums of the increments after each past window, oldest first, [L, B] in N.
        offset: Sum of the corrections so far, [B] in N; history[-1] + offset is the estimate.
    """

    hidden: Tensor
    cell: Tensor
    history: Tensor
    offset: Tensor


class FrameSlots(NamedTuple):
    """Which frame becomes available at which window.

    Attributes:
        frame: Row of the frame features, -1 where no frame becomes available, int64 [T, B].
        lag: Windows between the last estimate and the centre of the exposure, int64 [T, B].
    """

    frame: Tensor
    lag: Tensor


class Course(NamedTuple):
    """Result of a stretch of T windows of B sequences.

    Attributes:
        force: Force at the end of each window [N], [T, B].
        hidden: LSTM output h after each window, [T, B, lstm_size].
        state: State after the last window.
    """

    force: Tensor
    hidden: Tensor
    state: SequenceState


class CarriedHead(nn.Module):
    """The head of `mixtac_fger.shear`, which is fitted elsewhere: kept, scaled and written back.

    Args:
        config: Network configuration.
    """

    def __init__(self, config: FgerConfig) -> None:
        super().__init__()
        for name in ('frame', 'event'):
            part = nn.Module()
            part.register_buffer('weight', torch.zeros(3, 2 * config.cells))
            self.add_module(name, part)
        self.register_buffer('unit', torch.ones(3))
        self.register_buffer('deviation', torch.zeros(3, 3))


class FrameNetwork(nn.Module):
    """Phi_f: strided convolutions and a linear layer; plus the frames-only force.

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
        self.head = nn.Linear(config.frame_size, 1)

    def forward(self, frames: Tensor) -> Tensor:
        """Return f_frame [N, frame_size] of inputs [N, channels, rows, columns]."""
        maps = self.convolutions((frames - self.mean) / self.scale)
        return torch.relu(self.project(maps.flatten(1)))

    def force(self, features: Tensor) -> Tensor:
        """Return the frames-only force [N] (in N) of frame features [N, frame_size]."""
        return torch.Tensor(self.head(features))[:, 0]


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
        self.correction = perceptron(1 + config.frame_size, config.mlp_size)
        if config.shear:
            self.shear = CarriedHead(config)
        self.deviation = (
            DeviationHead(config.lstm_size, config.deviation_size)
            if config.deviation_size
            else None
        )

    def initial_state(self, sequences: int) -> SequenceState:
        """Return the state before the first window: no force, empty memory."""
        config, device = self.config, self.gates_force.weight.device
        zeros = torch.zeros(sequences, config.lstm_size, device=device)
        history = torch.zeros(config.history_windows, sequences, device=device)
        return SequenceState(zeros, zeros, history, torch.zeros(sequences, device=device))

    def forward(
        self,
        event_features: Tensor,
        frame_features: Tensor,
        slots: FrameSlots,
        state: SequenceState,
    ) -> Course:
        """Run T windows of B sequences.

        Args:
            event_features: Grid features, [T, B, grid rows, grid columns, 4].
            frame_features: f_frame of all frames that `slots` names, [N, frame_size].
            slots: When which frame becomes available.
            state: State before the first window.
        """
        events = self.event(event_features)
        drive = self.gates_event(events)
        direct, of_state = self._direct(events)
        arrivals = (slots.frame >= 0).any(dim=1).tolist()
        hidden, cell, offset = state.hidden, state.cell, state.offset
        past = list(state.history.unbind(0))
        forces, states = [], []
        for window, arrival in enumerate(arrivals):
            if arrival:
                here = FrameSlots(slots.frame[window], slots.lag[window])
                offset = offset + self._correction(past, offset, frame_features, here)
            estimate = (past[-1] + offset)[:, None]
            gates = drive[window] + self.gates_force(estimate) + self.gates_hidden(hidden)
            keep_in, keep_old, fresh, keep_out = gates.chunk(4, dim=1)
            cell = torch.sigmoid(keep_old) * cell + torch.sigmoid(keep_in) * torch.tanh(fresh)
            hidden = torch.sigmoid(keep_out) * torch.tanh(cell)
            middle = torch.relu(direct[window] + linear(hidden, of_state))
            past.append(past[-1] + self.increment[2](middle)[:, 0])
            forces.append(past[-1] + offset)
            states.append(hidden)
        history = torch.stack(past[-self.config.history_windows :])
        last = SequenceState(hidden, cell, history, offset)
        return Course(torch.stack(forces), torch.stack(states), last)

    def _direct(self, events: Tensor) -> tuple[Tensor, Tensor]:
        """Split the hidden layer of MLP_df: the loop over windows is what takes the time.

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

    def _correction(
        self, past: list[Tensor], offset: Tensor, frame_features: Tensor, slots: FrameSlots
    ) -> Tensor:
        """Return the correction [B] that the frames arriving now ask for, 0 where none arrives."""
        depth = 1
        if self.config.correction_point == 'exposure_centre':
            depth += min(int(slots.lag.max()), self.config.history_windows - 1)
        recent = torch.stack(past[-depth:])
        row = (depth - 1 - slots.lag).clamp(0, depth - 1)
        then = recent.gather(0, row[None])[0] + offset
        features = frame_features[slots.frame.clamp(min=0)]
        fusion = torch.cat([then[:, None], features], dim=1)
        return torch.where(slots.frame >= 0, self.correction(fusion)[:, 0], 0.0)


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
