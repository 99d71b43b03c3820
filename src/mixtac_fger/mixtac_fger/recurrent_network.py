# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The recurrent path and the uncertainty head, compiled: they run 500 times a second.

Memory is fixed; nothing is allocated per window. The torch network of `mixtac_learning.network` is
the reference that this is tested against. Only `EventGain` is not part of it: it is fitted to the
sensor at run time.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mixtac_fger.config import (
    CELL_FEATURES,
    HIGHEST_LOG_DEVIATION,
    LOWEST_LOG_DEVIATION,
    FgerConfig,
)
from mixtac_fger.frame_network import copied
from mixtac_fger.weights import Tensors

F32 = NDArray[np.float32]


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


class HeadWeights(NamedTuple):
    """Weights of a network of two layers with one output, float32.

    Attributes:
        hidden: [inputs, width].
        hidden_bias: [width].
        output: [width].
        output_bias: One element.
        scale: Factor of the output, one element.
    """

    hidden: F32
    hidden_bias: F32
    output: F32
    output_bias: F32
    scale: F32


class StepState(NamedTuple):
    """State and scratch memory of the recurrent path, float32 unless noted.

    Attributes:
        hidden: LSTM output h.
        cell: LSTM cell C.
        force: Present estimate [N], one element.
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
        copied(tensors.get('context.weight', np.zeros((0, 0)))),
    )


def _layer(tensors: Tensors, name: str) -> tuple[F32, F32]:
    """Return copies of weights [inputs, outputs] and biases of a layer."""
    return copied(tensors[f'{name}.weight'].T), copied(tensors[f'{name}.bias'])


def head_weights(tensors: Tensors, first: str, second: str, scale: str = '') -> HeadWeights:
    """Return copies of a head's weights in the layout of the compiled step.

    Args:
        tensors: Of a weight file.
        first: Name of the first layer.
        second: Name of the second layer.
        scale: Name of the scale; empty for 1.
    """
    return HeadWeights(
        *_layer(tensors, first),
        copied(tensors[f'{second}.weight'][0]),
        copied(tensors[f'{second}.bias']),
        copied(tensors[scale] if scale else np.ones(1)),
    )


def deviation_weights(tensors: Tensors) -> HeadWeights:
    """Return the weights of `deviation`."""
    return head_weights(tensors, 'deviation.hidden', 'deviation.output', 'deviation.scale')


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
    """Update hidden, cell and force by one window, and return the increment of the force [N].

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
    if weights.increment_hidden.shape[0] > size:
        _accumulate(state.event_output, weights.increment_hidden[size:], state.increment_hidden)
    _relu(state.increment_hidden)
    total = weights.increment_output_bias[0]
    for index in range(state.increment_hidden.shape[0]):
        total += state.increment_hidden[index] * weights.increment_output[index]
    state.force[0] += total
    return total


@njit(cache=True, nogil=True)
def correction(force: float, frame_feature: F32, weights: HeadWeights) -> Any:  # noqa: ANN401
    """Return MLP_corr of an estimate [N] and a frame feature: the correction [N]."""
    total = weights.output_bias[0]
    for column in range(weights.hidden.shape[1]):
        value = weights.hidden_bias[column] + np.float32(force) * weights.hidden[0, column]
        for row in range(frame_feature.shape[0]):
            value += frame_feature[row] * weights.hidden[row + 1, column]
        total += max(value, np.float32(0.0)) * weights.output[column]
    return total


@njit(cache=True, nogil=True)
def deviation(state: F32, force: float, moved: float, weights: HeadWeights) -> Any:  # noqa: ANN401
    """Return the standard deviation [N] of a force.

    Args:
        state: Recurrent state h after the window, [lstm_size].
        force: Force at its end [N].
        moved: Size of the sum of the increments that no frame has confirmed yet [N].
        weights: Weights of the deviation head.
    """
    total = weights.output_bias[0]
    for column in range(weights.hidden.shape[1]):
        value = weights.hidden_bias[column] + np.float32(force) * weights.hidden[-2, column]
        value += np.float32(moved) * weights.hidden[-1, column]
        for row in range(state.shape[0]):
            value += state[row] * weights.hidden[row, column]
        total += max(value, np.float32(0.0)) * weights.output[column]
    bounded = min(max(total, np.float32(LOWEST_LOG_DEVIATION)), np.float32(HIGHEST_LOG_DEVIATION))
    return weights.scale[0] * np.exp(bounded)


class EventGain:
    r"""The gain of a sensor's events, measured with its frames.

    Contrast thresholds, gels and beads differ from sensor to sensor, and so does the sum A of the
    increments from events for the same change of force. From one frame to the next,

    .. math:: \Delta F = g A,

    where F is the corrected force at the centre of the exposure. g is estimated by least squares
    with the forgetting factor `KEPT` per frame. Noise events make A larger, which lowers g: events
    that explain nothing of what frames show count nothing. The prior is g = 1. Blows are not used:
    their events saturate, and no frame shows them.

    Args:
        unit: What one newton of the constants is; see `FgerConfig.force_unit`.

    Attributes:
        value: The gain.
    """

    PRIOR_N: Final = 0.5
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
        # The prior is left out: it must not fade.
        self._squares = self._products = 0.0
        self._before: tuple[float, float] | None = None
        self.value = 1.0

    def forget_frame(self) -> None:
        """Restart with the next frame; the gain is kept: it belongs to the sensor."""
        self._before = None

    def frame(self, force: float, increments: float) -> None:
        """Add a frame.

        Args:
            force: Corrected force at the centre of its exposure [N].
            increments: Sum of all increments until then [N].
        """
        before, self._before = self._before, (force, increments)
        if before is None:
            return
        change, added = force - before[0], increments - before[1]
        if max(abs(change), abs(added)) >= self._largest:
            return
        self._squares = self.KEPT * self._squares + added**2
        self._products = self.KEPT * self._products + added * change
        gain = (self._products + self._prior) / (self._squares + self._prior)
        self.value = min(max(gain, 0.0), self.LARGEST)


SETTLE_WINDOWS = 100
"""Windows after which the recurrent state has settled at a force."""


class RecurrentPath:
    """State of the recurrent path: LSTM, force estimate and the estimates of the recent past.

    Args:
        config: Network configuration.
        tensors: Of its weight file; copied.
    """

    def __init__(self, config: FgerConfig, tensors: Tensors) -> None:
        self._config = config
        self._event_shape = (config.grid_rows, config.grid_columns, CELL_FEATURES)
        self._weights = step_weights(tensors)
        self._correction = head_weights(tensors, 'correction.0', 'correction.2')
        self._deviation = deviation_weights(tensors) if config.deviation_size else None
        self._state = step_state(self._weights)
        self._history = np.zeros(config.history_windows, np.float32)
        self._sums = np.zeros(config.history_windows)
        self._newest = 0
        self._confirmed = 0.0
        self._gain = EventGain(config.force_unit)
        self.see(np.zeros(config.feature_size, np.float32))

    @property
    def force(self) -> float:
        """Present estimate: the network's, with the gain of the events since the last frame [N]."""
        return self.network_force + (self._gain.value - 1.0) * self.moved

    @property
    def network_force(self) -> float:
        """Present estimate of the network alone [N]."""
        return float(self._state.force[0])

    @property
    def moved(self) -> float:
        """Sum of the increments since the exposure of the frame that corrected last [N]."""
        return float(self._sums[self._newest]) - self._confirmed

    @property
    def deviation(self) -> float | None:
        """Standard deviation of the present estimate [N]; None of a model that has none."""
        if self._deviation is None:
            return None
        hidden, force = self._state.hidden, self._state.force[0]
        return float(deviation(hidden, force, abs(self.moved), self._deviation))

    def change_sensor(self) -> None:
        """Forget the gain of the events."""
        self._gain = EventGain(self._config.force_unit)

    def clear(self) -> None:
        """Reset the force and the memory; the gain of the events is kept."""
        kept = self._state.context.copy()
        for part in self._state:
            part[:] = 0.0
        self._state.context[:] = kept
        self._gain.forget_frame()
        self._history[:] = 0.0
        self._sums[:] = 0.0
        self.confirm()

    def confirm(self) -> None:
        """Count the increments up to now as confirmed."""
        self._confirmed = float(self._sums[self._newest])

    def see(self, frame_feature: F32) -> None:
        """Use the feature of the latest frame, which relates motion and force."""
        matrix, context = self._weights.context, self._state.context
        context[:] = self._weights.increment_hidden_bias
        if matrix.size:
            context += matrix @ frame_feature

    def start_at(self, force: float) -> None:
        """Start at a known force [N], with the memory of a rest at this force without events.

        With an empty memory, which fits no force, the next increments would be wrong.
        """
        self.clear()
        still = np.zeros(self._event_shape, np.float32)
        for _ in range(SETTLE_WINDOWS):
            self._state.force[0] = force
            advance(still, self._weights, self._state)
        self._state.force[0] = force
        self._history[:] = force

    def correct(self, frame_feature: F32, lag: int) -> float:
        """Correct the estimate and its past by a frame; returns the change of `force` [N].

        Args:
            frame_feature: f_frame of the frame.
            lag: Windows between the last estimate and the centre of the exposure.
        """
        before, size = self.force, len(self._history)
        if self._config.correction_point != 'exposure_centre':
            lag = 0
        place = (self._newest - min(max(lag, 0), size - 1)) % size
        then = self._history[place]
        change = correction(then, frame_feature, self._correction)
        self._confirmed = float(self._sums[place])
        self._gain.frame(float(then + change), self._confirmed)
        self._history += np.float32(change)
        self._state.force[0] += change
        return self.force - before

    def forget_frame(self) -> None:
        """Do not compare the next frame with those before it."""
        self._gain.forget_frame()

    def mean(self, lag: int, half: int) -> float:
        """Return the mean of past estimates [N].

        Args:
            lag: Windows between the last estimate and their middle.
            half: Windows before and after the middle; fewer if later windows do not exist yet.
        """
        return float(self._history.take(self._around(lag, half), mode='wrap').mean())

    def blow(self, lag: int, half: int) -> bool:
        """Return whether past windows are part of a blow, which no frame shows; see `mean`."""
        places = self._around(lag, half)
        sums = self._sums.take([places[0] - 1, *places], mode='wrap')
        return bool(np.ptp(sums) > self._config.force_unit * BLOW_N)

    def _around(self, lag: int, half: int) -> NDArray[np.int64]:
        middle = self._newest - min(lag, len(self._history) - half - 2)
        return np.arange(middle - half, min(middle + half, self._newest) + 1)

    def shift(self, change: float) -> None:
        """Change the estimate and its past [N]."""
        self._history += np.float32(change)
        self._state.force[0] += change
        self._gain.forget_frame()

    def step(self, features: F32) -> float:
        """Advance by one window and return the increment of the network's force [N].

        Args:
            features: Grid features, float32 [grid rows, grid columns, 4].
        """
        increment = float(advance(features, self._weights, self._state))
        total = self._sums[self._newest] + increment
        self._newest = (self._newest + 1) % len(self._history)
        self._history[self._newest] = self._state.force[0]
        self._sums[self._newest] = total
        return increment
