# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""One window of the recurrent path, compiled: what runs 500 times a second."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np
from numba import njit

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_fger.network import FgerNetwork

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


class CorrectionWeights(NamedTuple):
    """Weights of MLP_corr, float32, matrices as [inputs, outputs]."""

    hidden: F32
    hidden_bias: F32
    output: F32
    output_bias: F32


class StepState(NamedTuple):
    """State and scratch memory of the recurrent path, float32.

    Attributes:
        hidden: LSTM output h.
        cell: LSTM cell C.
        force: Present estimate [N], one element.
        scaled: Scratch for the scaled event features.
        event_hidden: Scratch.
        event_output: Scratch.
        gates: Scratch.
        increment_hidden: Scratch.
    """

    hidden: F32
    cell: F32
    force: F32
    scaled: F32
    event_hidden: F32
    event_output: F32
    gates: F32
    increment_hidden: F32


def step_weights(network: FgerNetwork) -> StepWeights:
    """Return copies of the recurrent path's weights in the layout of the compiled step."""
    event = network.event
    increment = cast('Any', network.increment)
    return StepWeights(
        event_scale=_array(event.scale),
        event_hidden=_array(event.hidden.weight.T),
        event_hidden_bias=_array(event.hidden.bias),
        event_output=_array(event.output.weight.T),
        event_output_bias=_array(event.output.bias),
        gates_event=_array(network.gates_event.weight.T),
        gates_bias=_array(network.gates_event.bias),
        gates_force=_array(network.gates_force.weight[:, 0]),
        gates_hidden=_array(network.gates_hidden.weight.T),
        increment_hidden=_array(increment[0].weight.T),
        increment_hidden_bias=_array(increment[0].bias),
        increment_output=_array(increment[2].weight[0]),
        increment_output_bias=_array(increment[2].bias),
    )


def correction_weights(network: FgerNetwork) -> CorrectionWeights:
    """Return copies of MLP_corr's weights in the layout of the compiled step."""
    hidden, _, output = cast('Any', network.correction)
    return CorrectionWeights(
        _array(hidden.weight.T), _array(hidden.bias), _array(output.weight[0]), _array(output.bias)
    )


def _array(tensor: Any) -> F32:  # noqa: ANN401
    return np.array(tensor.detach().numpy(), np.float32, order='C')


def step_state(weights: StepWeights) -> StepState:
    """Return a state at zero with its scratch memory."""
    lstm = weights.gates_hidden.shape[0]
    sizes = (
        lstm,
        lstm,
        1,
        weights.event_hidden.shape[0],
        weights.event_hidden.shape[1],
        weights.event_output.shape[1],
        4 * lstm,
        weights.increment_hidden.shape[1],
    )
    return StepState(*(np.zeros(size, np.float32) for size in sizes))


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
def advance(features: F32, weights: StepWeights, state: StepState) -> None:
    """Update hidden, cell and force by one window.

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
    state.increment_hidden[:] = weights.increment_hidden_bias
    _accumulate(state.hidden, weights.increment_hidden[:size], state.increment_hidden)
    if weights.increment_hidden.shape[0] > size:
        _accumulate(state.event_output, weights.increment_hidden[size:], state.increment_hidden)
    _relu(state.increment_hidden)
    total = weights.increment_output_bias[0]
    for index in range(state.increment_hidden.shape[0]):
        total += state.increment_hidden[index] * weights.increment_output[index]
    state.force[0] += total


@njit(cache=True, nogil=True)
def correction(force: float, frame_feature: F32, weights: CorrectionWeights) -> Any:  # noqa: ANN401
    """Return MLP_corr of an estimate [N] and a frame feature: the correction [N]."""
    total = weights.output_bias[0]
    for column in range(weights.hidden.shape[1]):
        value = weights.hidden_bias[column] + np.float32(force) * weights.hidden[0, column]
        for row in range(frame_feature.shape[0]):
            value += frame_feature[row] * weights.hidden[row + 1, column]
        total += max(value, np.float32(0.0)) * weights.output[column]
    return total
