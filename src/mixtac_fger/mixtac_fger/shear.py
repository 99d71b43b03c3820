# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
r"""Sideways force and torsion, from the moments of the displacement (`mixtac_fger.moments`).

Along each axis the sideways force is a weighted sum of S and L, and the torsion one of the moments
of turning T. Between frames, the moments of the event flow are added.

The value y is that of the latest frame plus the increments since the centre of its exposure; the
output follows a frame over some windows. Its standard deviation is
:math:`\sqrt{b^2 + (s y)^2 + (h i)^2 + r^2}`: a floor b, a share s of the value, a share h of the
sum i of the absolute increments, and the correction r that the output has yet to follow. Values are
those of a gel of usual stiffness times `shear.unit`, which `mixtac_fger.fger_net.with_gain` and
`with_sideways_gain` change.

Axes are those of the contact frame: x to the right and y upwards in the image, z from the contact
into the gel (right-handed, REP-103). Forces act on the skin.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mixtac_fger.config import MOMENTS, PRESSES
from mixtac_fger.moments import along_flow

if TYPE_CHECKING:
    from mixtac_fger.config import FgerConfig
    from mixtac_fger.weights import Tensors

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

NEWTONS: Final = (1.0, 1.0, 1e-3)
"""Units of the output of the network: newtons, and newton millimetres for the torque."""


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


class Shown(NamedTuple):
    """The measurement of a frame, for a gel of usual stiffness.

    Attributes:
        value: Force to the right and upwards [N], torque [N mm]; float64 [3].
        per_flow: Change of `value` by a flow of one pixel per contrast threshold, x and y, in each
            cell of the event grid; float64 [3, grid rows, grid columns, 2].
    """

    value: F64
    per_flow: F64


@njit(cache=True, nogil=True)
def _advance(features: F32, per_flow: F64, before: F64, after: F64) -> None:
    """Write the sums [2, 3] after a window, given those before it."""
    for axis in range(3):
        increment = along_flow(features, per_flow[axis])
        after[0, axis] = before[0, axis] + increment
        after[1, axis] = before[1, axis] + abs(increment)


@njit(cache=True, nogil=True)
def _values(base: F64, sums: F64, pending: F64, units: F64, shares: F64, out: F64) -> bool:
    """Write values and deviations [2, 3]; return whether all are finite."""
    for axis in range(3):
        value = base[0, axis] + sums[0, axis] - pending[axis]
        moved = base[1, axis] + sums[1, axis]
        floor, share, drift = shares[axis, 0], shares[axis, 1] * value, shares[axis, 2] * moved
        square = floor * floor + share * share + drift * drift + pending[axis] * pending[axis]
        out[0, axis], out[1, axis] = units[axis] * value, units[axis] * np.sqrt(square)
    return bool(np.isfinite(out.sum()))


def across_per_moment(pull: F64, turning: F64) -> F64:
    """Return sideways force x and y and torsion per moment, [3, `MOMENTS`].

    Args:
        pull: Weights of S and L, [2].
        turning: Weights of the moments of turning, [4].
    """
    found = np.zeros((3, MOMENTS))
    found[[0, 1], [PRESSES, PRESSES + 1]], found[[0, 1], [PRESSES + 2, PRESSES + 3]] = pull
    found[2, -len(turning) :] = turning
    return found


class ShearHead:
    """Sideways force and torsion with their state; memory is fixed.

    `measure` may be called from another thread than the rest.

    Args:
        config: Network configuration.
        tensors: Of its weight file; copied.
    """

    def __init__(self, config: FgerConfig, tensors: Tensors) -> None:
        def tensor(name: str) -> F64:
            return np.array(tensors[name], np.float64)

        self._per_moment = across_per_moment(tensor('shear.pull'), tensor('shear.turning'))
        self._units = tensor('shear.unit') * NEWTONS
        self._shares = tensor('shear.deviation')
        # Sums of the increments and of their sizes up to each window.
        self._sums = np.zeros((config.history_windows, 2, 3))
        self._newest, self._base = 0, np.zeros((2, 3))
        self._per_flow = np.zeros((3, *config.grid_shape, 2))
        self._pending, self._windows = np.zeros(3), 0
        self._known = False
        self._found = np.zeros((2, 3))

    def measure(self, feature: F32, per_flow: F64) -> Shown:
        """Return the measurement of a frame.

        Args:
            feature: Moments of the frame over their spread, float32 [14].
            per_flow: Of `mixtac_fger.moments.FlowMoments`.
        """
        per_moment = self._per_moment
        return Shown(per_moment @ feature, np.tensordot(per_moment, per_flow, 1))

    def correct(self, shown: Shown, lag: int, windows: int = 1) -> None:
        """Correct the value by the measurement of a frame.

        Args:
            shown: Of `measure`.
            lag: Windows between the centre of its exposure and the latest one.
            windows: Windows in which the output follows.
        """
        place = (self._newest - min(lag, len(self._sums) - 1)) % len(self._sums)
        base = shown.value - self._sums[place, 0]
        change = base - self._base[0]
        self._base[0], self._base[1] = base, -self._sums[place, 1]
        if self._known and np.isfinite(change).all():
            self._pending += change
            self._windows = windows
        else:
            self._pending[:], self._windows = 0.0, 0
        self._per_flow, self._known = shown.per_flow, True

    def step(self, features: F32) -> None:
        """Advance by one window.

        Args:
            features: Grid features, float32 [grid rows, grid columns, 4].
        """
        before, self._newest = self._sums[self._newest], (self._newest + 1) % len(self._sums)
        _advance(features, self._per_flow, before, self._sums[self._newest])
        if self._windows:
            self._pending -= self._pending / self._windows
            self._windows -= 1

    def clear(self) -> None:
        """Forget everything; there is no value until the next frame."""
        self._sums[:] = self._base[:] = self._pending[:] = 0.0
        self._windows, self._known = 0, False

    @property
    def course(self) -> F64:
        """Value [N, N, N mm], before `shear.unit`, and size of the increments, [2, 3]."""
        sums = self._sums[self._newest]
        return np.stack([self._base[0] + sums[0] - self._pending, self._base[1] + sums[1]])

    @property
    def value(self) -> Shear | None:
        """The value after the latest window; None before the first frame, or if not finite."""
        if not self._known:
            return None
        sums, found = self._sums[self._newest], self._found
        if not _values(self._base, sums, self._pending, self._units, self._shares, found):
            return None
        (x, y, torque), (across, up, turned) = found.tolist()
        return Shear(x, y, torque, max(across, up), turned)
