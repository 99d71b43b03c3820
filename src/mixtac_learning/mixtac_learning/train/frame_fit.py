# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
r"""Fits the forces that frames show to the moments of their displacement (`mixtac_fger.moments`).

How stiff a gel is cannot be seen: a force is its stiffness times the visible displacement. Each
sensor k of the training data has therefore a gain :math:`g_k` of the normal force, and one of the
forces across it. With the moments m of a frame,

.. math:: F = g_k \, (p \cdot m).

Constants and gains are fitted in turn: the constants by least squares in which large errors count
linearly, the gains by plain least squares, drawn towards 1. Their geometric mean is 1, so that the
constants describe a gel of usual stiffness. A new sensor has gains of 1 until it is calibrated.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
import torch
from numpy.typing import NDArray

from mixtac_fger.config import PRESSES

if TYPE_CHECKING:
    from mixtac_learning.network import FgerNetwork

F64 = NDArray[np.float64]

ROUNDS: Final = 12
"""Rounds of both fits; the last changes no constant by more than 1 %."""
KNEE: Final = 0.02
"""Errors above this count linearly, below it quadratically [N; 10 N mm of torsion]."""
GAIN_WEIGHT: Final = 1.0
"""Weight of a gain of 1 beside the sum of squares of the forces of a sensor [N^2]."""
LEAST_WEIGHT: Final = 1e-3
"""Weight of constants of 0, in frames."""
START_WEIGHT: Final = 30.0
"""Weight of the constants of a network that is adapted, in frames."""


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """All frames of the trials.

    Attributes:
        moments: Of each frame, float64 [N, 14].
        force: Mean label over its exposure [N], [N].
        across: Sideways force x, y [N] and torsion [N mm], nan where unknown, [N, 3].
        sensor: Which sensor it is of, counted from 0, int64 [N].
    """

    moments: F64
    force: F64
    across: F64
    sensor: NDArray[np.int64]

    @property
    def known(self) -> NDArray[np.bool_]:
        """Whether the forces across the normal are known, [N]."""
        return np.asarray(np.isfinite(self.across).all(1))


@torch.no_grad()
def fit_frames(network: FgerNetwork, frames: Frames, *, adapts: bool = False) -> torch.Tensor:
    """Fit the constants of the forces that frames show, in place.

    Args:
        network: FGER-Net; where it is adapted, only the normal force changes.
        frames: To fit to.
        adapts: Whether the network is trained: its gains stay 1.

    Returns:
        Gains of the normal and of the sideways force of each sensor, float32 [sensors, 2].
    """
    gains = np.ones((int(frames.sensor.max()) + 1, 2))
    constants = network.frame
    if not adapts:
        # One for both directions.
        square = np.mean(frames.moments**2, axis=0)
        for first in (PRESSES, PRESSES + 2, PRESSES + 4):
            square[first : first + 2] = square[first : first + 2].mean()
        constants.spread.copy_(torch.from_numpy(np.maximum(np.sqrt(square), 1e-3)))
    inputs = frames.moments / constants.spread.double().numpy()
    presses = inputs[:, :PRESSES]
    if adapts:
        start = constants.press.double().numpy()
        press = fit_constants(presses, frames.force, start=start)
    else:
        press, gains[:, 0] = fit_with_gains(presses, frames.force, frames.sensor)
    constants.press.copy_(torch.from_numpy(press))
    known = frames.known
    if network.config.shear and not adapts and known.any():
        inputs, across, sensor = inputs[known], frames.across[known], frames.sensor[known]
        rows = [inputs[:, [PRESSES + axis, PRESSES + 2 + axis]] for axis in range(2)]
        sensors = np.tile(sensor, 2)
        pull, gains[:, 1] = fit_with_gains(np.concatenate(rows), across[:, :2].T.ravel(), sensors)
        network.shear.pull.copy_(torch.from_numpy(pull))
        torsion = across[:, 2] / gains[sensor, 1]
        turning = fit_constants(inputs[:, -len(network.shear.turning) :], torsion, 10.0 * KNEE)
        network.shear.turning.copy_(torch.from_numpy(turning))
    return torch.from_numpy(gains).float()


def fit_with_gains(inputs: F64, values: F64, sensor: NDArray[np.int64]) -> tuple[F64, F64]:
    """Return constants [K] and the gain of each sensor, so that values = gain (inputs @ constants).

    Args:
        inputs: float64 [N, K].
        values: float64 [N].
        sensor: Of each row, counted from 0, int64 [N].
    """
    gains = np.ones(int(sensor.max()) + 1)
    for _ in range(ROUNDS):
        constants = fit_constants(inputs, values / gains[sensor])
        found = inputs @ constants
        products = np.bincount(sensor, found * values, len(gains))
        squares = np.bincount(sensor, found * found, len(gains))
        gains = np.maximum((products + GAIN_WEIGHT) / (squares + GAIN_WEIGHT), 0.1)
        gains /= np.exp(np.log(gains).mean())
    return fit_constants(inputs, values / gains[sensor]), gains


def fit_constants(inputs: F64, values: F64, knee: float = KNEE, start: F64 | None = None) -> F64:
    """Return constants so that values = inputs @ constants, by reweighted least squares.

    Args:
        inputs: float64 [N, K], of a size of about 1.
        values: float64 [N].
        knee: Errors above this count linearly.
        start: Constants to which the fit is drawn; None for 0.
    """
    size, weights = inputs.shape[1], np.ones(len(values))
    prior = LEAST_WEIGHT if start is None else START_WEIGHT
    drawn = np.zeros(size) if start is None else prior * start
    for _ in range(ROUNDS):
        weighted = inputs * weights[:, None]
        found = np.linalg.solve(
            weighted.T @ inputs + prior * np.eye(size), weighted.T @ values + drawn
        )
        weights = knee / np.maximum(np.abs(values - inputs @ found), knee)
    return np.asarray(found)
