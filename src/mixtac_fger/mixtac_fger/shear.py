# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
r"""Sideways force and torsion: a linear head beside FGER-Net, which leaves the normal force alone.

A frame gives them from the displacement of the beads since the reference, the mean :math:`d` of
each cell of the event grid, and the normal force F that it shows:

.. math:: y_a = u_a \, (F / f)^{p_a} \; w_a \cdot d

The power stands for the width of the contact, which goes as the cube root of the force (Hertz): a
wider one is stiffer against a pull, and still more against a turn. :math:`u_a` is the stiffness of
the gel over the usual one, f is `FgerConfig.force_unit`. Each window adds an increment of the same
form from the flow of its events. The value is the latest frame's, and the increments since the
centre of its exposure; its deviation :math:`\sqrt{b^2 + (s y)^2 + (e i)^2}` has a floor, a share of
the value and one of i, the sum of the sizes of these increments.

Axes are those of the contact frame: x to the right and y upwards in the image, z from the contact
into the gel (right-handed, REP-103). Forces act on the skin.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mixtac_fger.features import bin_cells

if TYPE_CHECKING:
    from mixtac_fger.config import FgerConfig
    from mixtac_fger.weights import Tensors

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

POWERS: Final = (1.0 / 3.0, 1.0 / 3.0, 2.0 / 3.0)
"""Powers of the normal force, of force x, force y, torque z."""
HIGHEST: Final = 1.5
"""Normal force beyond which the contact counts as no wider, over `FgerConfig.force_unit` [N]."""
NEWTONS: Final = (1.0, 1.0, 1e-3)
"""Units of what the head computes: newtons, and newton millimetres for the torque."""


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

    def scaled(self, normal: float, sideways: float) -> Shear:
        """Return the value of a sensor with these gains.

        Args:
            normal: Gain of the normal force, which torsion shares.
            sideways: Gain of the sideways force.
        """
        x, y, deviation = (sideways * each for each in (self.x, self.y, self.deviation))
        return Shear(x, y, normal * self.torque, deviation, normal * self.torque_deviation)


@njit(cache=True, nogil=True)
def cell_means(
    flow_x: F32, flow_y: F32, row_cell: NDArray[np.int64], column_cell: NDArray[np.int64], out: F32
) -> None:
    """Write the mean displacement of each cell.

    Args:
        flow_x: Displacement since the reference to the right, float32 [rows, columns] [bins].
        flow_y: Downwards.
        row_cell: Grid row of each row, int64 [rows].
        column_cell: Grid column of each column, int64 [columns].
        out: float32 [grid rows, grid columns, 2].
    """
    out[:] = 0.0
    count = np.zeros(out.shape[:2], np.float32)
    for row in range(flow_x.shape[0]):
        for column in range(flow_x.shape[1]):
            i, j = row_cell[row], column_cell[column]
            out[i, j, 0] += flow_x[row, column]
            out[i, j, 1] += flow_y[row, column]
            count[i, j] += np.float32(1.0)
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j, 0] /= count[i, j]
            out[i, j, 1] /= count[i, j]


@njit(cache=True, nogil=True, fastmath={'contract'})
def weighted(cells: F32, force: float, weights: F32, powers: F64, out: F64) -> None:
    """Write force^p w . d of each axis.

    Args:
        cells: Displacement or flow in the first two features, [grid rows, grid columns, 2 or more].
        force: Normal force over the unit of the model [N].
        weights: float32 [3, grid rows, grid columns, 2].
        powers: Of each axis, float64 [3].
        out: float64 [3].
    """
    base = min(max(force, 0.0), HIGHEST)
    for axis in range(out.shape[0]):
        total = 0.0
        for i in range(cells.shape[0]):
            for j in range(cells.shape[1]):
                total += cells[i, j, 0] * weights[axis, i, j, 0]
                total += cells[i, j, 1] * weights[axis, i, j, 1]
        out[axis] = total * base ** powers[axis]


@njit(cache=True, nogil=True)
def _advance(
    features: F32, force: float, weights: F32, powers: F64, before: F64, after: F64
) -> None:
    """Write the sums [2, 3] after a window, given those before it."""
    weighted(features, force, weights, powers, after[0])
    for axis in range(3):
        after[1, axis] = before[1, axis] + abs(after[0, axis])
        after[0, axis] += before[0, axis]


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
    """The head with its state; memory is fixed.

    `measure` may be called from another thread than the rest.

    Args:
        config: Network configuration.
        tensors: Of its weight file, those of the head included; copied.
    """

    def __init__(self, config: FgerConfig, tensors: Tensors) -> None:
        self._unit = config.force_unit
        self._channels = [config.frame_channels.index(name) for name in ('flow_x', 'flow_y')]
        self._cells = bin_cells(config.frame_shape, config.grid_shape)
        shape = (*config.grid_shape, 2)
        self._means = np.zeros(shape, np.float32)
        self._frame, self._event = (
            np.array(tensors[f'shear.{name}.weight'], np.float32).reshape(3, *shape)
            for name in ('frame', 'event')
        )
        self._units = np.array(tensors['shear.unit'], np.float64) * NEWTONS
        self._shares = np.array(tensors['shear.deviation'], np.float64)
        self._powers = np.array(POWERS)
        self._measured, self._values = np.zeros(3), np.zeros((2, 3))
        # Sums of the increments and of their sizes up to each window.
        self._sums = np.zeros((config.history_windows, 2, 3))
        self._newest, self._base = 0, np.zeros((2, 3))
        self._known = False

    def measure(self, inputs: F32, force: float) -> F64:
        """Return what a frame shows: right, up [N], torque [N mm], for a gel of usual stiffness.

        Args:
            inputs: Input of the frame network, float32 [channels, rows, columns].
            force: Normal force that the frame shows [N].
        """
        x, y = (inputs[channel] for channel in self._channels)
        cell_means(x, y, *self._cells, self._means)
        weighted(self._means, force / self._unit, self._frame, self._powers, self._measured)
        return self._measured.copy()

    def correct(self, measured: F64, lag: int) -> None:
        """Take what a frame showed `lag` windows before the latest one."""
        place = (self._newest - min(lag, len(self._sums) - 1)) % len(self._sums)
        self._base[0] = measured - self._sums[place, 0]
        self._base[1] = -self._sums[place, 1]
        self._known = True

    def step(self, features: F32, force: float) -> None:
        """Advance by one window.

        Args:
            features: Features of its events, float32 [grid rows, grid columns, 4].
            force: Normal force [N].
        """
        before, self._newest = self._sums[self._newest], (self._newest + 1) % len(self._sums)
        after = self._sums[self._newest]
        _advance(features, force / self._unit, self._event, self._powers, before, after)

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
