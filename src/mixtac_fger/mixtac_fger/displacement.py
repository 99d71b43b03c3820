# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Displacement of the beads since the no-contact reference, in pixels and in millimetres of skin.

Iterated least squares (Lucas and Kanade) between log contrasts: each step moves the reference by
the displacement found so far, and measures what remains. Exposure and lamp current have no effect.

A gel that warms grows: all beads move away from the middle of the picture, in proportion to their
distance from it, over minutes. `Growth` separates this from contact.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mixtac_core.events.frames import bin_mean, displacement, gradients
from mixtac_fger.config import MOMENTS, FgerConfig
from mixtac_fger.moments import moments

F32 = NDArray[np.float32]

STEPS: Final = 3
"""Steps of the iteration; the third changes less than 1 % at 1 N."""
RADIUS: Final = 2
"""Half width of the least-squares box [bins]: two fifths of the distance of neighbouring beads."""
RIDGE: Final = 1e-3
"""As `FgerConfig.flow_regularisation`; the iteration undoes its bias where there is texture."""
BLOCK: Final = 2
"""Bins of a point of the field along each axis."""
NOMINAL_PX_PER_MM: Final = 12.0
"""Scale of the picture at the skin on the optical axis [px/mm]: mean of the virtual sensors."""
NOMINAL_DEVIATION: Final = 0.08
"""Its relative standard deviation between them (tolerances of lens, gap and gel)."""


DISTANCE_MM: Final = 15.9
"""Apparent distance from the lens to the skin [mm]: mean of the virtual sensors."""
DISTANCE_DEVIATION: Final = 0.06
"""Its relative standard deviation between them."""
MEASURED_DEVIATION: Final = 0.01
"""Relative standard deviation of a scale that was measured."""


CORNERS: Final = 0.68
"""Distance from the middle of the picture, over that of its corners, from which on growth is
measured."""
FOLLOWED: Final = 0.2
"""Share of a deviation that the growth follows in each frame while the contact does not change."""
LEAST_GROWTH: Final = 1.5e-4
"""Growth that is not corrected: 0.02 N. Noise stays below it in 62 of 75 simulated trials, and
reaches 4e-4 in slides."""
LARGEST_GROWTH: Final = 0.01
"""Bound of the growth; silicone reaches it after 30 K."""
STEADY: Final = 1.0
"""Change of the press from frame to frame at which half of a deviation is due to the contact
[bins]: 0.04 N."""
FIRST_FAR: Final = 5e-5
"""Displacement of the corners per press before the first contact [1/bin]; 6e-6 to 1.1e-4 on nine
sensors of two simulators."""
FIRST_PRESSES: Final = 25.0
"""Weight of `FIRST_FAR` beside frames, whose weight is the square of their press [bins^2]."""
MOST_PRESSES: Final = 8000.0
"""Weight of all earlier frames at most [bins^2]: about twelve frames of a press of 1 N."""


@dataclass(frozen=True, slots=True)
class SkinScale:
    """How the skin appears in the picture.

    The contact frame has its origin at the skin on the optical axis, x to the right in the image, y
    upwards in the image, z into the gel, towards the camera.

    Attributes:
        px_per_mm: Scale at the skin on the optical axis [px/mm].
        deviation: Its relative standard deviation.
        axis_px: Column and row of the optical axis; None is the middle of the image.
    """

    px_per_mm: float = NOMINAL_PX_PER_MM
    deviation: float = NOMINAL_DEVIATION
    axis_px: tuple[float, float] | None = None

    def axis(self, width: int, height: int) -> tuple[float, float]:
        """Return column and row of the optical axis in an image of a size [px]."""
        return self.axis_px or (0.5 * (width - 1), 0.5 * (height - 1))


def skin_scale(px_per_mm: float, focal_px: float, axis_px: tuple[float, float]) -> SkinScale:
    """Return the scale by the best that is known.

    Args:
        px_per_mm: Measured at the skin [px/mm]; 0 if it was not.
        focal_px: Focal length of the calibrated camera [px]; 0 without a calibration.
        axis_px: Its principal point, column and row.
    """
    axis = axis_px if focal_px > 0.0 else None
    if px_per_mm > 0.0:
        return SkinScale(px_per_mm, MEASURED_DEVIATION, axis)
    if focal_px > 0.0:
        return SkinScale(focal_px / DISTANCE_MM, DISTANCE_DEVIATION, axis)
    return SkinScale()


@dataclass(frozen=True, slots=True, eq=False)
class DisplacementField:
    """Displacement on a grid of points; along columns and rows of the image (y downwards).

    Attributes:
        moved: Displacement x and y [px], float32 [2, rows, columns].
        tensor: Structure tensor xx, xy, yy of a bin of the picture [log units^2/px^2], float32
            [3, rows, columns]: how much texture there is to measure by.
        noise: Root mean square of the residual between picture and displaced reference [log units].
        spacing_px: Distance of neighbouring points [px]; the first lies half of it from the corner.
        bin_px: Pixels of a bin of the picture along each axis.
    """

    moved: F32
    tensor: F32
    noise: float
    spacing_px: int
    bin_px: int

    def confidence(self) -> F32:
        """Return how far each displacement is to be believed, 0 to 1, float32 [rows, columns].

        One half where its standard deviation in the less certain direction, from the texture of the
        point's box and the noise, is a quarter of a pixel.
        """
        xx, xy, yy = self.tensor
        low = 0.5 * (xx + yy - np.sqrt((xx - yy) ** 2 + 4.0 * xy * xy))
        box = (2 * RADIUS + 1) ** 2
        deviation = self.noise / np.sqrt(box * np.maximum(low, 1e-9))
        return np.asarray(1.0 / (1.0 + (deviation / 0.25) ** 2), np.float32)


@njit(cache=True, nogil=True)
def displaced(image: F32, flow: F32, out: F32) -> None:
    """Write an image displaced by a flow [bins], float32 [2, rows, columns]: bilinear.

    The border repeats.
    """
    rows, columns = image.shape
    for row in range(rows):
        for column in range(columns):
            x = min(max(column - flow[0, row, column], np.float32(0.0)), np.float32(columns - 1))
            y = min(max(row - flow[1, row, column], np.float32(0.0)), np.float32(rows - 1))
            left, top = min(int(x), columns - 2), min(int(y), rows - 2)
            p, q = x - left, y - top
            above = (1 - p) * image[top, left] + p * image[top, left + 1]
            below = (1 - p) * image[top + 1, left] + p * image[top + 1, left + 1]
            out[row, column] = (1 - q) * above + q * below


@njit(cache=True, nogil=True)
def _measure(
    reference: F32, image: F32, work: F32, step: F32, flow: F32, moved: F32, tensor: F32
) -> float:
    """Write displacement [bins] and structure tensor [1/bin^2] of blocks; return the residual."""
    rows, columns = image.shape
    flow[:] = 0.0
    for _ in range(STEPS):
        displaced(reference, flow, tensor[3])
        displacement(tensor[3], image, np.int64(RADIUS), RIDGE, work, step)
        for axis in range(2):
            for row in range(rows):
                for column in range(columns):
                    flow[axis, row, column] += step[axis, row, column]
    displaced(reference, flow, tensor[3])
    gradients(tensor[3], np.int64(1), work[5], work[6])
    square = 0.0
    for row in range(rows):
        for column in range(columns):
            gx, gy = work[5, row, column], work[6, row, column]
            tensor[0, row, column] = gx * gx
            tensor[1, row, column] = gx * gy
            tensor[2, row, column] = gy * gy
            left = image[row, column] - tensor[3, row, column]
            square += left * left
    for axis in range(5):
        bin_mean(flow[axis] if axis < 2 else tensor[axis - 2], np.int64(BLOCK), moved[axis])
    return float(np.sqrt(square / (rows * columns)))


class Growth:
    """Growth of the gel since the reference, apart from what a contact displaces.

    The displacement by a contact falls off towards the corners of the picture, and that by growth
    rises. The mean outward displacement of the corners is therefore the growth plus a small
    multiple of the press D (`mixtac_fger.moments`). The multiple is a property of the gel. It is
    fitted to the frames in which the press changes, because growth is slow; in the other frames the
    growth follows.

    Args:
        shape: Rows and columns of the displacement [bins].

    Attributes:
        value: The growth to correct, as a part of the length; 0 up to `LEAST_GROWTH`.
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        places = [np.arange(count) - 0.5 * (count - 1) for count in shape]
        self._places = np.stack(np.meshgrid(*places[::-1])).astype(np.float32)
        radius = np.hypot(*self._places)
        weight = np.maximum(radius - CORNERS * radius.max(), 0.0)
        self._corners = self._places * (weight / np.sum(weight * radius**2))
        self._along = np.empty_like(self._places)
        unit = np.empty(MOMENTS, np.float32)
        moments(self._places, unit)
        self._press_of_growth = float(unit[0])
        self.value = self._found = 0.0
        self._press: float | None = None
        self._far, self._presses = FIRST_FAR, FIRST_PRESSES

    def grown(self, reference: F32) -> F32:
        """Return the reference of a gel that has grown; to first order, as displacements are.

        Args:
            reference: Coarse log contrast without contact, float32 [rows, columns].
        """
        if not self.value:
            return reference
        gradients(reference, 1, *self._along)
        change = np.einsum('arc,arc->rc', self._along, self._places)
        return np.asarray(reference - np.float32(self.value) * change)

    def follow(self, flow: F32, press: float) -> None:
        """Add a frame.

        Args:
            flow: Displacement against the grown reference [bins], float32 [2, rows, columns].
            press: Its moment D [bins].
        """
        seen = float(np.vdot(self._corners, flow))
        # What growth adds to the press must not look like a contact.
        press -= self._press_of_growth * seen
        if self._press is None:
            # The gel may have grown since a stored reference.
            self._press, self._found = press, seen - self._far * press
        steady = 1.0 / (1.0 + ((press - self._press) / STEADY) ** 2)
        deviation = self.value + seen - self._found - self._far * press
        found = self._found + FOLLOWED * steady * deviation
        self._found = min(max(found, -LARGEST_GROWTH), LARGEST_GROWTH)
        self.value = self._found - min(max(self._found, -LEAST_GROWTH), LEAST_GROWTH)
        self._presses = min(self._presses + (1.0 - steady) * press**2, MOST_PRESSES)
        self._far += (1.0 - steady) * deviation * press / self._presses
        self._press = press


class FieldMeter:
    """Measures displacement fields; holds scratch memory, so one per thread.

    Args:
        config: How frames become log contrasts.
    """

    def __init__(self, config: FgerConfig) -> None:
        rows, columns = config.frame_shape
        self._bin = config.frame_bin
        self._work = np.empty((9, rows, columns), np.float32)
        self._step, self._flow = (np.empty((2, rows, columns), np.float32) for _ in range(2))
        self._tensor = np.empty((4, rows, columns), np.float32)
        self.shape = rows // BLOCK, columns // BLOCK

    def measure(self, reference: F32, image: F32) -> DisplacementField:
        """Return the displacement of a picture.

        Args:
            reference: Coarse log contrast without contact, float32 `FgerConfig.frame_shape`.
            image: Coarse log contrast now, same shape.
        """
        out = np.empty((5, *self.shape), np.float32)
        noise = _measure(reference, image, self._work, self._step, self._flow, out, self._tensor)
        out[:2] *= self._bin
        out[2:] /= self._bin**2
        return DisplacementField(out[:2], out[2:], float(noise), BLOCK * self._bin, self._bin)


def field_places(
    field_shape: tuple[int, int], spacing_px: int, scale: SkinScale, size: tuple[int, int]
) -> F32:
    """Return x and y of a field's points in the contact frame [mm], float32 [2, rows, columns].

    Args:
        field_shape: Rows and columns of points.
        spacing_px: Their distance [px].
        scale: Of the skin in the picture.
        size: Columns and rows of the image [px].
    """
    rows, columns = field_shape
    column, row = scale.axis(*size)
    x = (spacing_px * (np.arange(columns) + 0.5) - 0.5 - column) / scale.px_per_mm
    y = -(spacing_px * (np.arange(rows) + 0.5) - 0.5 - row) / scale.px_per_mm
    return np.stack(np.meshgrid(x, y)).astype(np.float32)
