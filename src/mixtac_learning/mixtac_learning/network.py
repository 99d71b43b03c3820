# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""FGER-Net in torch: the paper's Algorithm 1 over batches of sequences, with uncertainty."""

from __future__ import annotations

from dataclasses import asdict
from typing import NamedTuple, cast

import torch
from torch import Tensor, nn
from torch.nn.functional import linear

from mixtac_fger.config import (
    ARCHITECTURE,
    CELL_FEATURES,
    MOMENTS,
    PRESSES,
    TURNING_WIDTHS,
    VERSION,
    FgerConfig,
    ModelError,
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
        seen: Features of the latest frame, [B, 14].
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
        frame: Row of the features of frames, -1 where no frame becomes available, int64 [T, B].
        lag: Windows between the last estimate and the centre of the exposure, int64 [T, B].
    """

    frame: Tensor
    lag: Tensor

    def latest(self) -> Tensor:
        """Return one more than the window of the latest frame, 0 before the first, [T, B]."""
        number = torch.arange(1, len(self.frame) + 1, device=self.frame.device)[:, None]
        return torch.where(self.frame >= 0, number, 0).cummax(dim=0).values


class Constants(nn.Module):
    """Tensors by name that are fitted, not trained by gradients.

    Args:
        values: The tensors, as they are before the fit.
    """

    def __init__(self, **values: Tensor) -> None:
        super().__init__()
        for name, value in values.items():
            self.register_buffer(name, value)

    def __getattr__(self, name: str) -> Tensor:
        """Return a tensor."""
        return cast('Tensor', super().__getattr__(name))


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

    Attributes:
        frame: Of the normal force of a frame. `spread` of each moment, [14]: features of a frame
            are its moments over these. `press`: per D, D r^2 and D r^4 over their spread [N], [3].
        shear: Of sideways force and torsion (`mixtac_fger.force_path`). `pull`: per S and L over
            their spread [N], [2]. `turning`: per moment of turning over its spread [N mm], [4].
            `unit`: Factor of each axis. `deviation`: Floor, share of the value and share of the
            increments, by axis.
    """

    def __init__(self, config: FgerConfig) -> None:
        super().__init__()
        self.config = config
        self.frame = Constants(spread=torch.ones(MOMENTS), press=torch.zeros(PRESSES))
        self.event = EventNetwork(config)
        gates = 4 * config.lstm_size
        self.gates_event = nn.Linear(config.event_size, gates)
        self.gates_force = nn.Linear(1, gates, bias=False)
        self.gates_hidden = nn.Linear(config.lstm_size, gates, bias=False)
        self.increment = perceptron(config.lstm_size + config.event_size, config.mlp_size)
        self.context = nn.Linear(MOMENTS, config.mlp_size, bias=False)
        if config.shear:
            self.shear = Constants(
                pull=torch.zeros(2),
                turning=torch.zeros(len(TURNING_WIDTHS)),
                unit=torch.ones(3),
                deviation=torch.zeros(3, 3),
            )
        self.deviation: Tensor
        self.register_buffer('deviation', torch.zeros(3))

    def frame_force(self, features: Tensor) -> Tensor:
        """Return the normal force of frames [N], [...], by their features [..., 14]."""
        return torch.Tensor(features[..., :PRESSES] @ self.frame.press)

    def initial_state(self, sequences: int) -> SequenceState:
        """Return the state before the first window: no force, empty memory."""
        config, device = self.config, self.gates_force.weight.device
        zeros = torch.zeros(sequences, config.lstm_size, device=device)
        history = torch.zeros(config.history_windows, sequences, device=device)
        offset = torch.zeros(sequences, device=device)
        seen = torch.zeros(sequences, MOMENTS, device=device)
        return SequenceState(zeros, zeros, history, offset, seen)

    def forward(
        self,
        event_features: Tensor,
        frames: Tensor,
        slots: FrameSlots,
        state: SequenceState,
    ) -> tuple[Tensor, SequenceState]:
        """Return the force [N] at the end of each window, [T, B], and the state after the last.

        Args:
            event_features: Grid features, [T, B, grid rows, grid columns, 4].
            frames: Features of all frames that `slots` names, [N, 14].
            slots: When which frame becomes available.
            state: State before the first window.
        """
        events = self.event(event_features)
        drive = self.gates_event(events)
        # Split: the loop over windows costs most of the time.
        hidden_layer, size = self.increment.get_submodule('0'), self.config.lstm_size
        weight, bias = (hidden_layer.get_parameter(name) for name in ('weight', 'bias'))
        of_state = weight[:, :size]
        features = torch.cat([state.seen[None], frames[slots.frame.clamp(min=0)]])
        latest = slots.latest()[..., None].expand(-1, -1, features.shape[-1])
        seen = features.gather(0, latest)
        direct = linear(events, weight[:, size:], bias) + self.context(seen)
        arrivals = (slots.frame >= 0).any(dim=1).tolist()
        # Cut once: the gradient of an index is as large as what it cuts from.
        shown, drives, directs = (
            each.unbind(0) for each in (self.frame_force(features[1:]), drive, direct)
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
        return torch.stack(forces), last

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
    return Model(ARCHITECTURE, VERSION, asdict(network.config), card, arrays_of(network))
