# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The recurrent network, compiled: it runs 500 times a second.

The torch network of `mixtac_learning.network` is the reference that this is tested against.
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
    """State of the recurrent path, float32.

    Attributes:
        hidden: LSTM output h.
        cell: LSTM cell C.
        context: Contribution of the latest frame to the hidden layer of the increments, with its
            bias.
    """

    hidden: F32
    cell: F32
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
    """Return a state at zero, and without a frame."""
    hidden, cell = np.zeros((2, weights.gates_hidden.shape[0]), np.float32)
    return StepState(hidden, cell, weights.increment_hidden_bias.copy())


@njit(cache=True, nogil=True, fastmath={'contract'})
def _accumulate(inputs: F32, matrix: F32, out: F32) -> None:
    """Add inputs @ matrix to `out`; a zero input costs nothing."""
    for row in range(inputs.shape[0]):
        value = inputs[row]
        if value != 0.0:
            for column in range(out.shape[0]):
                out[column] += value * matrix[row, column]


@njit(cache=True, nogil=True)
def _sigmoid(value: np.float32) -> Any:  # noqa: ANN401
    return np.float32(1.0) / (np.float32(1.0) + np.exp(-value))


@njit(cache=True, nogil=True)
def advance(features: F32, force: float, weights: StepWeights, state: StepState) -> Any:  # noqa: ANN401
    """Update hidden and cell by one window, and return the increment of the force [N].

    Args:
        features: Grid features, float32 [grid rows, grid columns, 4].
        force: Estimate that the network reads [N].
        weights: Weights of the recurrent path.
        state: Changed in place.
    """
    scaled = (features / weights.event_scale).reshape(-1)
    events = weights.event_hidden_bias.copy()
    _accumulate(scaled, weights.event_hidden, events)
    output = weights.event_output_bias.copy()
    _accumulate(np.maximum(events, np.float32(0.0)), weights.event_output, output)
    output = np.maximum(output, np.float32(0.0))
    gates = weights.gates_bias.copy()
    _accumulate(output, weights.gates_event, gates)
    gates += np.float32(force) * weights.gates_force
    _accumulate(state.hidden, weights.gates_hidden, gates)
    size = state.hidden.shape[0]
    for index in range(size):
        keep_in, keep_old = _sigmoid(gates[index]), _sigmoid(gates[size + index])
        fresh, keep_out = np.tanh(gates[2 * size + index]), _sigmoid(gates[3 * size + index])
        state.cell[index] = keep_old * state.cell[index] + keep_in * fresh
        state.hidden[index] = keep_out * np.tanh(state.cell[index])
    increment = state.context.copy()
    _accumulate(state.hidden, weights.increment_hidden[:size], increment)
    _accumulate(output, weights.increment_hidden[size:], increment)
    total = weights.increment_output_bias[0]
    for index in range(increment.shape[0]):
        total += max(increment[index], np.float32(0.0)) * weights.increment_output[index]
    return total
