# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The recurrent network, compiled: it runs 500 times a second.

Memory is fixed. The torch network of `mixtac_learning.network` is the reference that this is tested
against.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

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
