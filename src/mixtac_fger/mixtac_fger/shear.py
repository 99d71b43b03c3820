# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
r"""Sideways force and torsion beside the normal force.

A frame tells the sideways force by its feature, whose moments (`mixtac_fger.moments`) are most of
it, and the torsion by the moments of turning alone, each weighted by what the convolutions say
about gel and contact: :math:`T = \sum_k m_k (w_k \cdot f + b_k)`. Each window adds increments
from the recurrent state and its events. The value is the latest frame's, and the increments since
the centre of its exposure.
:math:`\sqrt{b^2 + (s y)^2 + (e i)^2}` is its deviation: a floor, a share of the value y and one of
i, the sum of the sizes of these increments. Values are those of a gel of usual stiffness times
`shear.unit`, which `mixtac_fger.fger_net.with_gain` and `with_sideways_gain` change.

Axes are those of the contact frame: x to the right and y upwards in the image, z from the contact
into the gel (right-handed, REP-103). Forces act on the skin.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

if TYPE_CHECKING:
    from mixtac_fger.config import FgerConfig
    from mixtac_fger.weights import Tensors

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

NEWTONS: Final = (1.0, 1.0, 1e-3)
"""Units of what the network computes: newtons, and newton millimetres for the torque."""


class Shear(NamedTuple):
    """Sideways force and torsion at the end of a window, in the contact frame.

    Attributes:
        x: Force on the skin to the right in the image [N].
        y: Upwards in the image [N].
        torque: Torque on the skin about z, from x to y [Nm].
        deviation: Standard deviation of the force per axis [N].
        torque_deviation: Of the torque [Nm].
    """

    x: float
    y: float
    torque: float
    deviation: float
    torque_deviation: float

    def scaled(self, gain: float) -> Shear:
        """Return the value of a sensor with a gain: the law is one for a pull and a torque."""
        return Shear._make(gain * each for each in self)


@njit(cache=True, nogil=True)
def _advance(increments: F32, before: F64, after: F64) -> None:
    """Write the sums [2, 3] after a window, given those before it."""
    for axis in range(3):
        after[0, axis] = before[0, axis] + increments[axis]
        after[1, axis] = before[1, axis] + abs(increments[axis])


@njit(cache=True, nogil=True)
def _values(base: F64, sums: F64, units: F64, shares: F64, out: F64) -> bool:
    """Write values and deviations [2, 3]; return whether all are finite."""
    for axis in range(3):
        value, moved = base[0, axis] + sums[0, axis], base[1, axis] + sums[1, axis]
        floor, share, told = shares[axis, 0], shares[axis, 1] * value, shares[axis, 2] * moved
        out[0, axis] = units[axis] * value
        out[1, axis] = units[axis] * np.sqrt(floor * floor + share * share + told * told)
    return bool(np.isfinite(out.sum()))


class ShearHead:
    """Sideways force and torsion with their state; memory is fixed.

    `measure` may be called from another thread than the rest.

    Args:
        config: Network configuration.
        tensors: Of its weight file; copied.
    """

    def __init__(self, config: FgerConfig, tensors: Tensors) -> None:
        names = ('frame.weight', 'frame.bias', 'turning.weight', 'turning.bias')
        self._frame = [np.array(tensors[f'shear.{name}'], np.float64) for name in names]
        self._units = np.array(tensors['shear.unit'], np.float64) * NEWTONS
        self._shares = np.array(tensors['shear.deviation'], np.float64)
        self._values = np.zeros((2, 3))
        # Sums of the increments and of their sizes up to each window.
        self._sums = np.zeros((config.history_windows, 2, 3))
        self._newest, self._base = 0, np.zeros((2, 3))
        self._known = False

    def measure(self, feature: F32) -> F64:
        """Return what a frame shows: right, up [N], torque [N mm], for a gel of usual stiffness.

        Args:
            feature: f_frame, float32 [feature_size].
        """
        weight, bias, gates, gates_bias = self._frame
        turning = gates @ feature[: gates.shape[1]] + gates_bias
        return np.append(weight @ feature + bias, feature[-len(turning) :] @ turning)

    def correct(self, measured: F64, lag: int) -> None:
        """Take what a frame showed `lag` windows before the latest one."""
        place = (self._newest - min(lag, len(self._sums) - 1)) % len(self._sums)
        self._base[0] = measured - self._sums[place, 0]
        self._base[1] = -self._sums[place, 1]
        self._known = True

    def step(self, increments: F32) -> None:
        """Advance by one window.

        Args:
            increments: Of `RecurrentPath.across`, float32 [3].
        """
        before, self._newest = self._sums[self._newest], (self._newest + 1) % len(self._sums)
        _advance(increments, before, self._sums[self._newest])

    def clear(self) -> None:
        """Forget everything; there is no value until the next frame."""
        self._sums[:] = self._base[:] = 0.0
        self._known = False

    @property
    def value(self) -> Shear | None:
        """The value after the latest window; None before the first frame, or if not finite."""
        if not self._known:
            return None
        sums = self._sums[self._newest]
        if not _values(self._base, sums, self._units, self._shares, self._values):
            return None
        (x, y, torque), (across, up, turned) = self._values.tolist()
        return Shear(x, y, torque, max(across, up), turned)
