# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Features of frames and event windows; training and live estimation run this same code."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mixtac_core.events.arrays import Events
from mixtac_core.events.errors import MixtacError
from mixtac_core.events.frames import bin_mean, displacement, gradients, log_contrast
from mixtac_fger.config import CELL_FEATURES, MOMENTS, FgerConfig
from mixtac_fger.displacement import Growth
from mixtac_fger.moments import moments
from mixtac_fger.validity import PictureFigures, picture_figures

F32 = NDArray[np.float32]
I8 = NDArray[np.int8]
U16 = NDArray[np.uint16]
Bools = NDArray[np.bool_]
Index = NDArray[np.int64]
Cells = tuple[Index, Index]
"""Grid row of each row of a map, and grid column of each of its columns."""
Places = tuple[Index, Index, U16]
"""The same of the bins, and the bin of each coordinate of an event that there can be."""


class ImageError(MixtacError):
    """An image message that the estimator cannot read."""


@njit(cache=True, nogil=True)
def cell_solvers(
    along_x: F32, along_y: F32, cells: Cells, pixels_per_bin: int, regularisation: float, out: F32
) -> None:
    """Write the inverse of each cell's regularised structure tensor.

    Args:
        along_x: Log-gradient along x [1/px], float32 [rows, columns] of bins.
        along_y: The same along y.
        cells: Of the bins, of `bin_cells`.
        pixels_per_bin: Sensor pixels in a bin.
        regularisation: Added per pixel to the diagonal [1/px^2].
        out: xx, xy, yy of the inverse, float32 [grid rows, grid columns, 3].
    """
    (rows, columns), (row_cell, column_cell) = along_x.shape, cells
    tensor = np.zeros((out.shape[0], out.shape[1], 3), np.float64)
    for row in range(rows):
        for column in range(columns):
            cell = tensor[row_cell[row], column_cell[column]]
            gx = np.float64(along_x[row, column])
            gy = np.float64(along_y[row, column])
            cell[0] += pixels_per_bin * (gx * gx + regularisation)
            cell[1] += pixels_per_bin * gx * gy
            cell[2] += pixels_per_bin * (gy * gy + regularisation)
    for row in range(out.shape[0]):
        for column in range(out.shape[1]):
            xx, xy, yy = tensor[row, column]
            inverse = 1.0 / (xx * yy - xy * xy)
            out[row, column, 0] = yy * inverse
            out[row, column, 1] = -xy * inverse
            out[row, column, 2] = xx * inverse


ONE_SIDED = 3.0
"""Events of one polarity per event of the other from which on a lamp may have made them."""
EVEN_NOISE = 1.4
"""Largest variance of the counts of cells over their mean, where a lamp made them."""
EVEN_SHARE = 0.2
"""Further standard deviation that the counts of cells may have, as a part of their mean."""


@njit(cache=True, nogil=True)
def _is_light(sums: F32) -> bool:
    """Return whether the events of a window are those of a lamp: of one polarity, and everywhere.

    A lamp that changes, or ripples, takes pixels over their thresholds wherever they are; motion
    makes events of both polarities, and a touch makes them in one place.
    """
    on, off, on_squares, off_squares = 0.0, 0.0, 0.0, 0.0
    for row in range(sums.shape[0]):
        for column in range(sums.shape[1]):
            brighter, darker = np.float64(sums[row, column, 2]), np.float64(sums[row, column, 3])
            on += brighter
            off += darker
            on_squares += brighter * brighter
            off_squares += darker * darker
    most, least, squares = (on, off, on_squares) if on > off else (off, on, off_squares)
    if most < ONE_SIDED * least:
        return False
    cells = sums.shape[0] * sums.shape[1]
    mean = most / cells
    variance = squares / cells - mean * mean
    return bool(variance < EVEN_NOISE * mean + (EVEN_SHARE * mean) ** 2)


LARGEST_BALANCE = 120
"""Largest balance that is kept, so that a hot pixel counts again 0.12 s after it fell silent."""
MOST_BALANCE = 24
"""ON less OFF events of a pixel lately, or the reverse, beyond which it is hot: a bead is at most
seven times darker than the gel, and an event is a step of a tenth at the least."""
FADING_WINDOWS = 10
"""Windows in which every balance fades by a quarter, a part of the rows in each."""


class EventGuide(NamedTuple):
    """Contribution of the latest frame to the features of an event window.

    Attributes:
        along_x: Log-gradient along x [1/px], float32 [rows, columns] of gradient bins.
        along_y: The same along y.
        solvers: Inverse structure tensors, float32 [grid rows, grid columns, 3].
    """

    along_x: F32
    along_y: F32
    solvers: F32


@njit(cache=True, nogil=True)
def grid_features(
    x: U16, y: U16, on: Bools, guide: EventGuide, cells: Places, limit: float, balance: I8, out: F32
) -> bool:
    """Write the features of one window: per cell flow x, flow y, ln(1 + ON), ln(1 + OFF).

    A bead edge that moves by u changes the log intensity by -g u; each event reports one threshold
    of that change with its sign, so the sums of sign times gradient give u per threshold by least
    squares. Events outside the map are ignored.

    Args:
        x: Columns, uint16 [n].
        y: Rows, uint16 [n].
        on: True where brighter, bool [n].
        guide: Of the latest frame.
        cells: Of the bins; the bins of the coordinates are a table, uint16 [65536], since divisions
            are what takes longest.
        limit: Bound of |flow| per axis [px per threshold].
        balance: ON less OFF events of each pixel lately, int8 [height, width]; updated. The events
            of a pixel beyond `MOST_BALANCE` are ignored.
        out: float32 [grid rows, grid columns, 4].

    Returns:
        Whether the events are those of a lamp, see `_is_light`.
    """
    rows, columns = guide.along_x.shape
    row_cell, column_cell, bins = cells
    out[:] = 0.0
    for index in range(x.shape[0]):
        row, column = bins[y[index]], bins[x[index]]
        if row >= rows or column >= columns:
            continue
        level, step = int(balance[y[index], x[index]]), 1 if on[index] else -1
        level += 2 * step if level * step < 0 else step
        balance[y[index], x[index]] = min(max(level, -LARGEST_BALANCE), LARGEST_BALANCE)
        if abs(level) > MOST_BALANCE:
            continue
        cell = out[row_cell[row], column_cell[column]]
        if on[index]:
            cell[0] += guide.along_x[row, column]
            cell[1] += guide.along_y[row, column]
            cell[2] += np.float32(1.0)
        else:
            cell[0] -= guide.along_x[row, column]
            cell[1] -= guide.along_y[row, column]
            cell[3] += np.float32(1.0)
    light: bool = _is_light(out)
    for row in range(out.shape[0]):
        for column in range(out.shape[1]):
            cell, inverse = out[row, column], guide.solvers[row, column]
            sum_x, sum_y = cell[0], cell[1]
            flow_x = -(inverse[0] * sum_x + inverse[1] * sum_y)
            flow_y = -(inverse[1] * sum_x + inverse[2] * sum_y)
            cell[0] = min(max(flow_x, -limit), limit)
            cell[1] = min(max(flow_y, -limit), limit)
            cell[2] = np.log1p(cell[2])
            cell[3] = np.log1p(cell[3])
    return light


@njit(cache=True, nogil=True)
def fade(balance: NDArray[np.int8]) -> None:
    """Reduce the balance of every pixel by a quarter; a small one stays.

    Args:
        balance: int8 [height, width]; changed.
    """
    for row in range(balance.shape[0]):
        for column in range(balance.shape[1]):
            level = int(balance[row, column])
            balance[row, column] = level - (level >> 2) if level > 0 else level + (-level >> 2)


COORDINATES = 2**16
"""Values that the coordinate of an event can have."""


@dataclass(frozen=True, slots=True, eq=False)
class Contrast:
    """Log contrast of one frame at the two resolutions in use.

    Attributes:
        fine: For the event guide, float32 `FgerConfig.gradient_shape`.
        coarse: For the displacement, float32 `FgerConfig.frame_shape`.
    """

    fine: F32
    coarse: F32


def light_basis(shape: Sequence[int]) -> F32:
    """Return an orthonormal basis of smooth changes of light, float32 [bins, 6].

    They are the polynomials of second degree in row and column: a lamp that fades, or wanders,
    changes the log contrast smoothly, and a contact moves beads.

    Args:
        shape: Rows and columns of the picture.
    """
    lines = (np.linspace(-1.0, 1.0, count) for count in shape)
    y, x = (axis.ravel() for axis in np.meshgrid(*lines, indexing='ij'))
    found, _ = np.linalg.qr(np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], 1))
    return found.astype(np.float32)


class FramePreparation:
    """Turns camera frames into log contrast, event guides and moments of displacement.

    Holds scratch memory and the growth of the gel: use one instance per thread and sensor.

    Args:
        config: Network configuration.

    Attributes:
        grown: The reference that the latest frame was compared with, grown as the gel.
    """

    def __init__(self, config: FgerConfig) -> None:
        self._config = config
        self._fine = np.empty(config.gradient_shape, np.float32)
        self._coarse = np.empty(config.frame_shape, np.float32)
        self._work = np.empty((9, *config.frame_shape), np.float32)
        self._flow = np.empty((2, *config.frame_shape), np.float32)
        self._even = np.empty(config.frame_shape, np.float32)
        self._moments = np.empty(MOMENTS, np.float32)
        self.grown = self._reference = np.empty(0, np.float32)
        self._growth = Growth(config.frame_shape)
        self._light = light_basis(config.frame_shape)
        self._cells = bin_cells(config.gradient_shape, config.grid_shape)

    def contrast(self, image: NDArray[np.uint16] | NDArray[np.uint8]) -> Contrast:
        """Return the log contrast of a frame.

        Args:
            image: Intensity, [height, width] of the configuration, any number of bits.

        Raises:
            ImageError: The image has another size.
        """
        config = self._config
        if image.shape != (config.height, config.width):
            raise ImageError(
                f'image of shape {image.shape}: the model reads {config.height} rows and'
                f' {config.width} columns; set the camera to full resolution, or choose a model of'
                ' its size'
            )
        bin_mean(image, config.gradient_bin, self._fine)
        bin_mean(self._fine, config.frame_bin // config.gradient_bin, self._coarse)
        result = Contrast(np.empty_like(self._fine), np.empty_like(self._coarse))
        log_contrast(self._fine, config.log_floor, result.fine)
        log_contrast(self._coarse, config.log_floor, result.coarse)
        return result

    def guide(self, contrast: Contrast) -> EventGuide:
        """Return what events are multiplied with while this frame is the latest."""
        config = self._config
        along_x, along_y = np.empty_like(contrast.fine), np.empty_like(contrast.fine)
        gradients(contrast.fine, config.gradient_bin, along_x, along_y)
        solvers = np.empty((config.grid_rows, config.grid_columns, 3), np.float32)
        per_bin, ridge = config.gradient_bin**2, config.cell_regularisation
        cell_solvers(along_x, along_y, self._cells, per_bin, ridge, solvers)
        return EventGuide(along_x, along_y, solvers)

    def compare(self, contrast: Contrast, reference: F32) -> tuple[F32, PictureFigures]:
        """Compare a frame with the reference.

        The part that a smooth change of light since the reference explains is first removed from
        the frame, and the reference grows as the gel did up to the frame before. A frame that no
        contact explains says nothing of the growth. Frames must be in order of time; another
        reference starts anew.

        Args:
            contrast: The frame.
            reference: Coarse log contrast without contact.

        Returns:
            The moments of the displacement since the reference, float32 [14], and what it explains.
        """
        config = self._config
        if reference is not self._reference:
            self._reference, self._growth = reference, Growth(config.frame_shape)
        self.grown = reference = self._growth.grown(reference)
        change = (contrast.coarse - reference).ravel()
        light = self._light @ (self._light.T @ change)
        np.subtract(contrast.coarse, light.reshape(reference.shape), out=self._even)
        radius, ridge = config.flow_radius, config.flow_regularisation
        displacement(reference, self._even, radius, ridge, self._work, self._flow)
        moments(self._flow, self._moments)
        picture = picture_figures(reference, self._even, self._flow)
        if picture.unexplained() < 1.0:
            self._growth.follow(self._flow, float(self._moments[0]))
        return self._moments.copy(), picture

    @property
    def growth(self) -> float:
        """Growth of the gel since the reference, as a part of its length."""
        return self._growth.value


def mean_contrast(parts: Iterable[F32]) -> F32:
    """Return the mean of log contrasts: a reference."""
    return np.asarray(np.mean(list(parts), axis=0), np.float32)


def bin_cells(shape: Sequence[int], grid: Sequence[int]) -> tuple[Index, Index]:
    """Return the grid row of each row of a map and the grid column of each column.

    Args:
        shape: Rows and columns of the map.
        grid: Rows and columns of the event grid.
    """
    rows, columns = (
        np.arange(bins, dtype=np.int64) * cells // bins
        for bins, cells in zip(shape, grid, strict=True)
    )
    return rows, columns


class WindowFeatures:
    """Computes the event features of windows in order, without those of hot pixels.

    A pixel cannot become brighter without end: one that says so is hot, and adds no more from
    `MOST_BALANCE` events on.

    Args:
        config: Network configuration.
    """

    def __init__(self, config: FgerConfig) -> None:
        self._config = config
        self._balance = np.zeros((config.height, config.width), np.int8)
        self._count = 0
        bins = (np.arange(COORDINATES) // config.gradient_bin).astype(np.uint16)
        self._places = (*bin_cells(config.gradient_shape, config.grid_shape), bins)
        self.shape = (config.grid_rows, config.grid_columns, CELL_FEATURES)

    def compute(self, events: Events, guide: EventGuide, out: F32) -> bool:
        """Write the features of a window to `out` (float32 `shape`); see `grid_features`.

        Returns:
            Whether the events are those of a lamp: the network is then given zeros.
        """
        config = self._config
        self._count += 1
        fade(self._balance[self._count % FADING_WINDOWS :: FADING_WINDOWS])
        pixels, limit = (events.x, events.y, events.polarity), config.flow_limit
        return bool(grid_features(*pixels, guide, self._places, limit, self._balance, out))


def correction_lag(estimate_us: int, mid_us: int, window_us: int) -> int:
    """Return how many windows before the estimate at `estimate_us` the one nearest `mid_us` is.

    Args:
        estimate_us: End of the latest window, camera clock [us].
        mid_us: Centre of the exposure, camera clock [us].
        window_us: Width of a window [us].
    """
    return max((estimate_us - mid_us + window_us // 2) // window_us, 0)
