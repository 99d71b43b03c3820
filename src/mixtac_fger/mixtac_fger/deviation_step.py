# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The uncertainty head as it runs live: compiled, without allocation of arrays per window."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numba import njit

from mixtac_fger.deviation_head import HIGHEST, LOWEST

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_fger.deviation_head import DeviationHead

    F32 = NDArray[np.float32]


class DeviationWeights(NamedTuple):
    """Weights of the head, float32.

    Attributes:
        hidden: [lstm_size + 1, width]; the last row belongs to the force.
        hidden_bias: [width].
        output: [width].
        output_bias: One element.
        scale: One element.
        middle: Scratch, [width].
    """

    hidden: F32
    hidden_bias: F32
    output: F32
    output_bias: F32
    scale: F32
    middle: F32


def deviation_weights(head: DeviationHead) -> DeviationWeights:
    """Return copies of the head's weights in the layout of the compiled step."""
    return DeviationWeights(
        _array(head.hidden.weight.T),
        _array(head.hidden.bias),
        _array(head.output.weight[0]),
        _array(head.output.bias),
        _array(head.scale),
        np.zeros(head.hidden.out_features, np.float32),
    )


def _array(tensor: Any) -> F32:  # noqa: ANN401
    return np.array(tensor.detach().numpy(), np.float32, order='C')


@njit(cache=True, nogil=True)
def deviation(state: F32, force: float, weights: DeviationWeights) -> Any:  # noqa: ANN401
    """Return the standard deviation [N] of a force.

    Args:
        state: Recurrent state h after the window, [lstm_size].
        force: Force at its end [N].
        weights: Of the head.
    """
    size = state.shape[0]
    middle = weights.middle
    for column in range(middle.shape[0]):
        middle[column] = (
            weights.hidden_bias[column] + np.float32(force) * weights.hidden[-1, column]
        )
    for row in range(size):
        for column in range(middle.shape[0]):
            middle[column] += state[row] * weights.hidden[row, column]
    total = weights.output_bias[0]
    for column in range(middle.shape[0]):
        total += max(middle[column], np.float32(0.0)) * weights.output[column]
    bounded = min(max(total, np.float32(LOWEST)), np.float32(HIGHEST))
    return weights.scale[0] * np.exp(bounded)
