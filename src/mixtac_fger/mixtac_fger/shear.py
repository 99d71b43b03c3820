# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
r"""Sideways force and torsion, and the moments of the displacement that they follow from.

Far from a load, a layer moves as if the load acted at one point. In a window that is much wider
than the contact, neither the shape of the contact nor the pressure distribution matters. With
:math:`x` from the contact, :math:`u` the displacement and :math:`g` a Gaussian of width :math:`w`,

.. math:: D = \sum x \cdot u \, g / w^2, \quad S = \sum u \, g / w, \quad
          T_w = \sum (x \times u) \, g / w^2

are proportional to the normal force, the sideways force and the torque; the constants depend on the
stiffness of the gel. For a press and a pull, T is zero; for a turn, D and S are zero. Beads that
are pressed towards the camera move away from the optical axis in the image. For a contact at c from
the axis, this adds to S a part proportional to :math:`L = D c / w`; L is therefore computed as
well.

The contact is at the mean of the places, weighted by the square of the divergence of u where that
is positive. A turn has no divergence. A pull shifts the mean along its own direction only, which
adds no moment.

The sideways force is a linear function of the feature of a frame, most of all of its moments.
The torsion is a weighted sum of the moments of turning; the convolutions adapt the weights to gel
and contact: :math:`T = \sum_k m_k (w_k \cdot f + b_k)`. Between frames, the moments of the event
flow, :math:`u = e \, v`, are added to the moments: v is the displacement per contrast threshold,
and e (`PER_EVENT`) scales it to the displacement in frames. The same constants convert both to a
force.

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

from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mixtac_fger.config import MOMENTS, TURNING_WIDTHS

if TYPE_CHECKING:
    from mixtac_fger.config import FgerConfig
    from mixtac_fger.weights import Tensors

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

RISE: Final = 2
"""Half the distance over which the divergence is taken [bins]."""


@njit(cache=True, nogil=True)
def moments(flow: F32, out: F32) -> None:
    """Write the moments of a displacement, in axes of the contact frame (x right, y upwards).

    Args:
        flow: Displacement x and y since the reference, y downwards [bins], [2, rows, columns].
        out: D, S right and up, L right and up, T over each of `TURNING_WIDTHS`; all but T over the
            last of these; [bins], float32 [`MOMENTS`]. 0 where nothing has moved.
    """
    rows, columns = flow.shape[1:]
    total, right, below = 0.0, 0.0, 0.0
    for row in range(RISE, rows - RISE):
        for column in range(RISE, columns - RISE):
            spread = flow[0, row, column + RISE] - flow[0, row, column - RISE]
            spread += flow[1, row + RISE, column] - flow[1, row - RISE, column]
            if spread > 0.0:
                weight = spread * spread
                total += weight
                right += weight * column
                below += weight * row
    out[:] = 0.0
    if not total > 0.0:
        return
    right, below = right / total, below / total
    for index in range(len(TURNING_WIDTHS)):
        width = TURNING_WIDTHS[index]
        across = np.exp(-0.5 * ((np.arange(columns) - right) / width) ** 2)
        press, pull_x, pull_y, turn = 0.0, 0.0, 0.0, 0.0
        for row in range(rows):
            y = row - below
            row_press, row_x, row_y, row_turn = 0.0, 0.0, 0.0, 0.0
            for column in range(columns):
                x = column - right
                u, v = across[column] * flow[0, row, column], across[column] * flow[1, row, column]
                row_x += u
                row_y += v
                row_press += x * u + y * v
                row_turn += y * u - x * v
            down = np.exp(-0.5 * (y / width) ** 2)
            press += down * row_press
            pull_x += down * row_x
            pull_y += down * row_y
            turn += down * row_turn
        out[MOMENTS - len(TURNING_WIDTHS) + index] = turn / (width * width)
        # What is left after the last width stays.
        out[0] = press / (width * width)
        out[1] = pull_x / width
        out[2] = -pull_y / width
        out[3] = out[0] * (right - 0.5 * (columns - 1)) / width
        out[4] = -out[0] * (below - 0.5 * (rows - 1)) / width


def contact_of(found: F32 | F64, shape: tuple[int, int]) -> tuple[float, float]:
    """Return column and row of the contact that moments are about [bins].

    Args:
        found: Of `moments`.
        shape: Rows and columns of the displacement.
    """
    rows, columns = shape
    right, below = 0.5 * (columns - 1), 0.5 * (rows - 1)
    press, _, _, lean_x, lean_y = found[:5].tolist()
    if press:
        right += TURNING_WIDTHS[-1] * lean_x / press
        below -= TURNING_WIDTHS[-1] * lean_y / press
    return min(max(right, 0.0), columns - 1.0), min(max(below, 0.0), rows - 1.0)


@njit(cache=True, nogil=True)
def moments_of_cells(contact: tuple[float, float], shape: tuple[int, int], out: F64) -> None:
    """Write the contribution of the displacements x and y of each cell of a grid to the moments.

    Args:
        contact: Column and row of the contact [bins].
        shape: Rows and columns of the displacement, which the cells divide evenly.
        out: float64 [`MOMENTS`, grid rows, grid columns, 2], y downwards.
    """
    rows, columns = out.shape[1:3]
    bins = shape[0] * shape[1] / (rows * columns)
    lean_x, lean_y = contact[0] - 0.5 * (shape[1] - 1), contact[1] - 0.5 * (shape[0] - 1)
    out[:] = 0.0
    for row in range(rows):
        for column in range(columns):
            cell = out[:, row, column]
            x = (column + 0.5) * shape[1] / columns - 0.5 - contact[0]
            y = (row + 0.5) * shape[0] / rows - 0.5 - contact[1]
            near, width = 0.0, 1.0
            for index in range(len(TURNING_WIDTHS)):
                width = TURNING_WIDTHS[index]
                near = bins * np.exp(-0.5 * (x * x + y * y) / width**2)
                turn = cell[MOMENTS - len(TURNING_WIDTHS) + index]
                turn[0], turn[1] = near * y / width**2, -near * x / width**2
            cell[0, 0], cell[0, 1] = near * x / width**2, near * y / width**2
            cell[1, 0], cell[2, 1] = near / width, -near / width
            for axis in range(2):
                cell[3, axis] = cell[0, axis] * lean_x / width
                cell[4, axis] = -cell[0, axis] * lean_y / width


PER_EVENT: Final = 0.4
"""Displacement in frames over displacement per contrast threshold from events."""


class FlowMoments:
    """What the flow of events adds to the moments of the latest frame; memory is fixed.

    Args:
        config: Network configuration.
        spread: Of each moment, float32 [9].
    """

    def __init__(self, config: FgerConfig, spread: F32) -> None:
        self._shape = config.frame_shape
        self._spread = np.array(spread, np.float64)
        self._cells = np.empty((MOMENTS, *config.grid_shape, 2))
        # Of a displacement in bins.
        self._scale = (PER_EVENT / config.frame_bin / self._spread)[:, None, None, None]

    def per_flow(self, feature: F32) -> F64:
        """Return the change of the moments by a flow of one pixel per contrast threshold.

        Args:
            feature: f_frame, float32 [feature_size].

        Returns:
            Change over the spread, by x and y in each cell, [9, grid rows, grid columns, 2].
        """
        contact = contact_of(feature[-MOMENTS:] * self._spread, self._shape)
        moments_of_cells(contact, self._shape, self._cells)
        return self._scale * self._cells


@njit(cache=True, nogil=True)
def along_flow(features: F32, per_flow: F64) -> Any:  # noqa: ANN401
    """Return the change of a force by the flow of a window.

    Args:
        features: Grid features, float32 [grid rows, grid columns, 4].
        per_flow: Change by a flow of one pixel per threshold, [grid rows, grid columns, 2].
    """
    total = 0.0
    for row in range(features.shape[0]):
        for column in range(features.shape[1]):
            cell, gain = features[row, column], per_flow[row, column]
            total += gain[0] * cell[0] + gain[1] * cell[1]
    return total


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

        self._frame = tensor('shear.frame.weight'), tensor('shear.frame.bias')
        self._turning = tensor('shear.turning.weight'), tensor('shear.turning.bias')
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
            feature: f_frame, float32 [feature_size].
            per_flow: Of `FlowMoments`.
        """
        (weight, bias), (gates, gates_bias) = self._frame, self._turning
        turning = gates @ feature[: gates.shape[1]] + gates_bias
        own = feature[-MOMENTS:]
        value = np.append(weight @ feature + bias, own[-len(turning) :] @ turning)
        per_moment = np.zeros((3, len(own)))
        per_moment[:2], per_moment[2, -len(turning) :] = weight[:, -len(own) :], turning
        return Shown(value, np.tensordot(per_moment, per_flow, 1))

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
