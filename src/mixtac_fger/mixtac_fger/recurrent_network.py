# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The recurrent path, compiled: it runs 500 times a second.

Memory is fixed. The torch network of `mixtac_learning.network` is the reference that this is tested
against. Only `EventGains` are not part of it: they are fitted to the sensor at run time.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mixtac_fger.config import CELL_FEATURES, MOMENTS, FgerConfig
from mixtac_fger.moments import along_flow
from mixtac_fger.weights import Tensors

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]


class StepWeights(NamedTuple):
    """Weights of the recurrent path, float32, matrices as [inputs, outputs]."""

    event_scale: F32
    event_hidden: F32
    event_hidden_bias: F32
    event_output: F32
    event_output_bias: F32
    gates_event: F32
    gates_bias: F32
    gates_force: F32
    gates_hidden: F32
    increment_hidden: F32
    increment_hidden_bias: F32
    increment_output: F32
    increment_output_bias: F32
    context: F32


class StepState(NamedTuple):
    """State and scratch memory of the recurrent path, float32 unless noted.

    Attributes:
        hidden: LSTM output h.
        cell: LSTM cell C.
        force: Estimate that the network reads [N], one element.
        scaled: Scratch for the scaled event features.
        event_hidden: Scratch.
        event_output: Scratch.
        gates: Scratch.
        increment_hidden: Scratch.
        context: Contribution of the latest frame to `increment_hidden`, bias included.
    """

    hidden: F32
    cell: F32
    force: F32
    scaled: F32
    event_hidden: F32
    event_output: F32
    gates: F32
    increment_hidden: F32
    context: F32


def step_weights(tensors: Tensors) -> StepWeights:
    """Return copies of the recurrent path's weights in the layout of the compiled step."""
    return StepWeights(
        copied(tensors['event.scale']),
        *_layer(tensors, 'event.hidden'),
        *_layer(tensors, 'event.output'),
        *_layer(tensors, 'gates_event'),
        copied(tensors['gates_force.weight'][:, 0]),
        copied(tensors['gates_hidden.weight'].T),
        *_layer(tensors, 'increment.0'),
        copied(tensors['increment.2.weight'][0]),
        copied(tensors['increment.2.bias']),
        copied(tensors['context.weight']),
    )


def copied(tensor: NDArray[np.generic]) -> F32:
    """Return a C-ordered float32 copy."""
    return np.array(tensor, np.float32, order='C')


def _layer(tensors: Tensors, name: str) -> tuple[F32, F32]:
    """Return copies of weights [inputs, outputs] and biases of a layer."""
    return copied(tensors[f'{name}.weight'].T), copied(tensors[f'{name}.bias'])


BLOW_N = 1.0
"""Range of the sum of increments around an exposure from which on there was a blow [N]."""


def step_state(weights: StepWeights) -> StepState:
    """Return a state at zero with its scratch memory."""
    hidden, output = weights.event_hidden.shape[1], weights.event_output.shape[1]
    lstm, increment = weights.gates_hidden.shape[0], weights.increment_hidden.shape[1]
    inputs = weights.event_hidden.shape[0]
    sizes = (lstm, lstm, 1, inputs, hidden, output, 4 * lstm, increment, increment)
    return StepState._make(np.zeros(size, np.float32) for size in sizes)


@njit(cache=True, nogil=True, fastmath={'contract'})
def _accumulate(inputs: F32, matrix: F32, out: F32) -> None:
    """Add inputs @ matrix to `out`; a zero input costs nothing."""
    for row in range(inputs.shape[0]):
        value = inputs[row]
        if value != 0.0:
            for column in range(out.shape[0]):
                out[column] += value * matrix[row, column]


@njit(cache=True, nogil=True)
def _relu(values: F32) -> None:
    for index in range(values.shape[0]):
        values[index] = max(values[index], np.float32(0.0))


@njit(cache=True, nogil=True)
def _sigmoid(value: np.float32) -> Any:  # noqa: ANN401
    return np.float32(1.0) / (np.float32(1.0) + np.exp(-value))


@njit(cache=True, nogil=True)
def advance(features: F32, weights: StepWeights, state: StepState) -> Any:  # noqa: ANN401
    """Update hidden and cell by one window, and return the increment of the force [N].

    Args:
        features: Grid features, float32 [grid rows, grid columns, 4].
        weights: Weights of the recurrent path.
        state: Changed in place.
    """
    flat = features.reshape(-1)
    kinds = weights.event_scale.shape[0]
    for index in range(flat.shape[0]):
        state.scaled[index] = flat[index] / weights.event_scale[index % kinds]
    state.event_hidden[:] = weights.event_hidden_bias
    _accumulate(state.scaled, weights.event_hidden, state.event_hidden)
    _relu(state.event_hidden)
    state.event_output[:] = weights.event_output_bias
    _accumulate(state.event_hidden, weights.event_output, state.event_output)
    _relu(state.event_output)
    gates = state.gates
    gates[:] = weights.gates_bias
    _accumulate(state.event_output, weights.gates_event, gates)
    for index in range(gates.shape[0]):
        gates[index] += state.force[0] * weights.gates_force[index]
    _accumulate(state.hidden, weights.gates_hidden, gates)
    size = state.hidden.shape[0]
    for index in range(size):
        keep_in, keep_old = _sigmoid(gates[index]), _sigmoid(gates[size + index])
        fresh, keep_out = np.tanh(gates[2 * size + index]), _sigmoid(gates[3 * size + index])
        state.cell[index] = keep_old * state.cell[index] + keep_in * fresh
        state.hidden[index] = keep_out * np.tanh(state.cell[index])
    state.increment_hidden[:] = state.context
    _accumulate(state.hidden, weights.increment_hidden[:size], state.increment_hidden)
    _accumulate(state.event_output, weights.increment_hidden[size:], state.increment_hidden)
    _relu(state.increment_hidden)
    total = weights.increment_output_bias[0]
    for index in range(state.increment_hidden.shape[0]):
        total += state.increment_hidden[index] * weights.increment_output[index]
    return total


class EventGains:
    r"""How much force the events of this sensor stand for, measured with its frames.

    Events say in two ways by how much the force has changed: A is the sum of the increments of the
    network, and B is the press that their flow adds to the moments of the frame. A is the more
    accurate one on the kind of sensor that the network was trained on, and the only one in blows.
    B is linear and makes fewer errors on any other. From one frame to the next,

    .. math:: \Delta F = g_A A + g_B B,

    where F is the force of the frames. The gains are estimated by recursive least squares with the
    forgetting factor `KEPT` per frame. Contrast thresholds, gels and beads differ from sensor to
    sensor, and so do the gains. Noise events make A and B larger, which lowers the gains: events
    that explain nothing of what frames show count nothing. Blows are not used: their events
    saturate, and no frame shows them.

    Args:
        unit: What one newton of the constants is; see `FgerConfig.force_unit`.

    Attributes:
        value: Both gains, float64 [2].
    """

    PRIOR: Final = (0.8, 0.15)
    """The gains before any frame, and where frames and events say little."""
    PRIOR_N: Final = 0.3
    """Change of the force whose weight the prior has [N]."""
    KEPT: Final = 0.998
    """Share of the sums that is kept from frame to frame."""
    LARGEST: Final = 4.0
    """Largest gain."""
    LARGEST_N: Final = 1.0
    """Change from one frame to the next from which on there was a blow [N]."""

    def __init__(self, unit: float = 1.0) -> None:
        self._largest = unit * self.LARGEST_N
        self._prior = (unit * self.PRIOR_N) ** 2
        self.value = np.array(self.PRIOR)
        # The prior is left out: it must not fade.
        self._squares, self._products = np.zeros((2, 2)), np.zeros(2)
        self._before: tuple[float, F64] | None = None

    def forget_frame(self) -> None:
        """Restart with the next frame; the gains are kept: they belong to the sensor."""
        self._before = None

    def frame(self, force: float, sums: F64) -> None:
        """Add a frame.

        Args:
            force: Force of the frame [N].
            sums: Of A and B until the centre of its exposure [N], [2]; kept.
        """
        before, self._before = self._before, (force, sums)
        if before is None:
            return
        change, added = force - before[0], sums - before[1]
        if max(abs(change), abs(float(self.value @ added))) >= self._largest:
            return
        self._squares = self.KEPT * self._squares + np.outer(added, added)
        self._products = self.KEPT * self._products + change * added
        squares = self._squares + self._prior * np.eye(2)
        found = np.linalg.solve(squares, self._products + self._prior * np.array(self.PRIOR))
        self.value = np.clip(found, 0.0, self.LARGEST)


SETTLE_WINDOWS = 100
"""Windows after which the recurrent state has settled at a force."""


class RecurrentPath:
    """The force of the latest frame, plus what events have added since its exposure.

    Args:
        config: Network configuration.
        tensors: Of its weight file; copied.

    Attributes:
        gains: How much force the events of this sensor stand for.
        shown: Force of the latest frame [N].
    """

    def __init__(self, config: FgerConfig, tensors: Tensors) -> None:
        self._unit = config.force_unit
        self._event_shape = (config.grid_rows, config.grid_columns, CELL_FEATURES)
        self._weights = step_weights(tensors)
        self._state = step_state(self._weights)
        # Of A and B of `EventGains`, after each window.
        self._sums = np.zeros((config.history_windows, 2))
        self._newest = 0
        self.shown, self._then = 0.0, np.zeros(2)
        self.gains = EventGains(self._unit)
        still = np.zeros((*config.grid_shape, 2))
        self.see(np.zeros(MOMENTS, np.float32), still)

    @property
    def force(self) -> float:
        """Present estimate [N]."""
        return self.shown + self.moved

    @property
    def moved(self) -> float:
        """Change of the force since the exposure of the latest frame, by events [N]."""
        return float(self.gains.value @ (self._sums[self._newest] - self._then))

    def change_sensor(self) -> None:
        """Forget the gains of the events."""
        self.gains = EventGains(self._unit)

    def clear(self) -> None:
        """Reset the force and the memory; the gains of the events are kept."""
        kept = self._state.context.copy()
        for part in self._state:
            part[:] = 0.0
        self._state.context[:] = kept
        self.gains.forget_frame()
        self._sums[:] = self._then[:] = self.shown = 0.0

    def see(self, frame_feature: F32, press: F64) -> None:
        """Relate motion and force by the latest frame from now on.

        Args:
            frame_feature: Moments of the frame over their spread, float32 [14].
            press: Change of the force by a flow of one pixel per threshold in each cell of the
                event grid [N], [grid rows, grid columns, 2].
        """
        weights = self._weights
        self._state.context[:] = weights.increment_hidden_bias + weights.context @ frame_feature
        self._press = press

    def start_at(self, force: float) -> None:
        """Start at a known force [N], with the memory of a rest at this force without events.

        With an empty memory, which fits no force, the next increments would be wrong.
        """
        self.clear()
        self.shown = force
        still = np.zeros(self._event_shape, np.float32)
        for _ in range(SETTLE_WINDOWS):
            self._state.force[0] = force
            advance(still, self._weights, self._state)

    def correct(self, force: float, lag: int) -> float:
        """Correct the estimate by a frame; returns the change of the present force [N].

        Args:
            force: Of the frame [N].
            lag: Windows between the last estimate and the centre of its exposure.
        """
        before = self.force
        self.shown, self._then = force, self._sums[self._back(lag)].copy()
        self.gains.frame(force, self._then)
        return self.force - before

    def blow(self, lag: int, half: int) -> bool:
        """Return whether past windows are part of a blow, which no frame shows.

        Args:
            lag: Windows between the last estimate and their middle.
            half: Windows before and after the middle; fewer if later windows do not exist yet.
        """
        middle = self._newest - min(lag, len(self._sums) - half - 2)
        places = np.arange(middle - half - 1, min(middle + half, self._newest) + 1)
        sums = self._sums[:, 0].take(places, mode='wrap')
        return bool(np.ptp(sums) > self._unit * BLOW_N)

    def _back(self, lag: int) -> int:
        size = len(self._sums)
        return (self._newest - min(max(lag, 0), size - 1)) % size

    def step(self, features: F32) -> None:
        """Advance by one window.

        Args:
            features: Grid features, float32 [grid rows, grid columns, 4].
        """
        # The network has learned with its own increments.
        self._state.force[0] = self.shown + self._sums[self._newest, 0] - self._then[0]
        added = advance(features, self._weights, self._state), along_flow(features, self._press)
        before, self._newest = self._sums[self._newest], (self._newest + 1) % len(self._sums)
        self._sums[self._newest] = before + added
