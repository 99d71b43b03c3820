# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The recurrent path as it runs live: fixed memory, no torch."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mixtac_fger.config import CELL_FEATURES
from mixtac_fger.deviation_step import deviation, deviation_weights
from mixtac_fger.packet_step import (
    advance,
    correction,
    correction_weights,
    step_state,
    step_weights,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_fger.network import FgerNetwork

    F32 = NDArray[np.float32]


SETTLE_WINDOWS = 100
"""Windows after which the recurrent state has settled at a force."""


class RecurrentPath:
    """State of the recurrent path: LSTM, force estimate and the estimates of the recent past.

    Args:
        network: Weights are copied out of it.
    """

    def __init__(self, network: FgerNetwork) -> None:
        self._config = config = network.config
        self._event_shape = (config.grid_rows, config.grid_columns, CELL_FEATURES)
        self._weights = step_weights(network)
        self._correction = correction_weights(network)
        head = network.deviation
        self._deviation = None if head is None else deviation_weights(head)
        self._state = step_state(self._weights)
        self._history = np.zeros(network.config.history_windows, np.float32)
        self._newest = 0

    @property
    def force(self) -> float:
        """Present estimate [N]."""
        return float(self._state.force[0])

    @property
    def deviation(self) -> float | None:
        """Standard deviation of the present estimate [N]; None of a model that has none."""
        if self._deviation is None:
            return None
        return float(deviation(self._state.hidden, self._state.force[0], self._deviation))

    def clear(self) -> None:
        """Forget everything: no force, no memory."""
        for part in self._state:
            part[:] = 0.0
        self._history[:] = 0.0

    def start_at(self, force: float) -> None:
        """Begin at a known force [N], with a memory of having been there without events.

        A memory of nothing belongs to no force: with it the next increments would be wrong.
        """
        self.clear()
        still = np.zeros(self._event_shape, np.float32)
        for _ in range(SETTLE_WINDOWS):
            self._state.force[0] = force
            advance(still, self._weights, self._state)
        self._state.force[0] = force
        self._history[:] = force

    def correct(self, frame_feature: F32, lag: int) -> None:
        """Correct the estimate and its past by a frame.

        Args:
            frame_feature: f_frame of the frame.
            lag: Windows between the last estimate and the centre of the exposure.
        """
        size = len(self._history)
        if self._config.correction_point != 'exposure_centre':
            lag = 0
        then = self._history[(self._newest - min(max(lag, 0), size - 1)) % size]
        change = correction(then, frame_feature, self._correction)
        self._history += np.float32(change)
        self._state.force[0] += change

    def step(self, features: F32) -> float:
        """Advance by one window and return the force [N] at its end.

        Args:
            features: Grid features, float32 [grid rows, grid columns, 4].
        """
        advance(features, self._weights, self._state)
        self._newest = (self._newest + 1) % len(self._history)
        self._history[self._newest] = self._state.force[0]
        return float(self._state.force[0])
