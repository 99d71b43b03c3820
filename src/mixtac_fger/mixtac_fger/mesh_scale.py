# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
r"""The scale of the picture by the steel mesh that carries the gel, whose pitch is known.

Beads lie anywhere and have no pitch; the mesh before them is a square lattice. Its wires are darker
than the beads and brighter than the skin, so that their contrast changes sign from place to place
and hardly shows in the spectrum of the picture. Where the picture is brighter than most of it, the
sign is turned round. The lattice whose harmonics stand out most of the spectrum is the mesh, if it
stands out by more than any other does.

The mesh is nearer to the lens than the skin. With the scale m at the mesh, the thickness t and the
refractive index n of the gel and the focal length f, the scale s at the skin is
:math:`1 / s = 1 / m + t / (n f)`.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from mixtac_fger.displacement import SkinScale

F64 = NDArray[np.float64]
DISTORTION: Final = (-0.26, 0.085)
"""Radial distortion of second and fourth order: mean of the virtual sensors."""
STEP_PX: Final = 2.0
"""Distance of the points at which the picture is looked at, distortion undone [px]."""
SIZE: Final = 512
"""Points of the spectrum along each axis."""
PERIODS_PX: Final = (12.0, 20.0)
"""Periods of the mesh that are looked for [px]."""
HARMONICS: Final = ((1, 0), (0, 1), (1, 1), (1, -1), (2, 0), (0, 2))
"""Waves of a square lattice."""
FINE_PX, SMOOTH_PX, SLOW_PX = 4.0, 4.0, 25.0
"""Widths (standard deviations): of what is no fine structure, of a bead's light, of the lamp's."""
BRIGHT_PART: Final = 0.7
"""Share of the picture that is darker than beads."""
CLIP: Final = 2.0
"""Contrasts beyond so many standard deviations do not count more."""
LEAST_LEAD: Final = 2.5
"""Smallest lead of the mesh over any other lattice [sum of logarithms of power]."""
NEAR: Final = (0.06, math.radians(5.0))
"""Periods (relative) and angles [rad] within which two lattices are one."""
MESH_DEVIATION: Final = 0.01
"""Relative standard deviation of the scale at the mesh (simulated: 0.007)."""
GEL_MM: Final = (4.5, 0.87)
"""Thickness of the gel and its standard deviation: virtual sensors [mm]."""
INDEX: Final = 1.41
"""Refractive index of silicone."""
FOCAL_PX: Final = (185.0, 4.0)
"""Focal length of the sensor's lens and its standard deviation: virtual sensors [px]."""


class Lattice(NamedTuple):
    """A square lattice in the picture.

    Attributes:
        period_px: On the optical axis [px].
        angle_rad: Of its waves against the rows, 0 to a quarter turn [rad].
        lead: By how much it stands out more than any other.
    """

    period_px: float
    angle_rad: float
    lead: float


def find_lattice(
    contrast: NDArray[np.float32], bin_px: int, axis_px: tuple[float, float]
) -> Lattice:
    """Return the square lattice that stands out most in a picture.

    Args:
        contrast: Log contrast without contact, float32 [rows, columns] of bins.
        bin_px: Pixels of a bin along each axis.
        axis_px: Column and row of the optical axis.
    """
    picture = _straight(np.asarray(contrast, np.float64), bin_px, axis_px)
    fine = picture - _smooth(picture, FINE_PX)
    light = _smooth(picture, SMOOTH_PX) - _smooth(picture, SLOW_PX)
    over = (light - np.quantile(light, BRIGHT_PART)) / max(0.3 * float(light.std()), 1e-9)
    fine *= -np.tanh(over)
    most = CLIP * 1.4826 * float(np.median(np.abs(fine)))
    fine = np.clip(fine, -most, most)
    window = np.outer(np.hanning(fine.shape[0]), np.hanning(fine.shape[1]))
    fine = (fine - (fine * window).sum() / window.sum()) * window
    power = np.abs(np.fft.fft2(fine, (SIZE, SIZE))) ** 2
    bands, places, (periods, angles) = _lattices()
    middle = [np.median(power[bands == band]) for band in range(int(bands.max()) + 1)]
    power /= np.maximum(np.array(middle), 1e-12)[bands]
    score = np.log1p(_between(power, *places)).sum(axis=0)
    best = np.unravel_index(int(score.argmax()), score.shape)
    period, angle = float(periods[best]), float(angles[best])
    apart = np.abs(angles - angle)
    same = np.minimum(apart, 0.5 * np.pi - apart) < NEAR[1]
    same &= np.abs(np.log(periods / period)) < NEAR[0]
    return Lattice(period, angle, float(score[best] - score[~same].max()))


def by_mesh(
    scale: SkinScale, contrast: NDArray[np.float32], bin_px: int, size: tuple[int, int]
) -> SkinScale:
    """Return the scale by the mesh in the picture; as given where it shows none.

    Args:
        scale: What is known; where its `mesh_mm` is 0, no mesh is looked for.
        contrast: Log contrast without contact, float32 [rows, columns] of bins.
        bin_px: Pixels of a bin along each axis.
        size: Columns and rows of the image [px].
    """
    if scale.mesh_mm <= 0.0:
        return scale
    found = find_lattice(contrast, bin_px, scale.axis(*size))
    if found.lead < LEAST_LEAD:
        return scale
    focal, focal_sd = (scale.focal_px, 0.0) if scale.focal_px > 0.0 else FOCAL_PX
    gel, gel_sd = (scale.gel_mm, 0.0) if scale.gel_mm > 0.0 else GEL_MM
    at_mesh, behind = scale.mesh_mm / found.period_px, gel / (INDEX * focal)
    parts = (at_mesh * MESH_DEVIATION, behind * math.hypot(focal_sd / focal, gel_sd / gel))
    whole = at_mesh + behind
    return replace(scale, px_per_mm=1.0 / whole, deviation=math.hypot(*parts) / whole)


def _straight(contrast: F64, bin_px: int, axis_px: tuple[float, float]) -> F64:
    """Return the picture at even steps, the mean lens's distortion undone."""
    rows, columns = (bin_px * count for count in contrast.shape)
    column, row = axis_px
    half = [STEP_PX * (min(a, n - a) // STEP_PX) for a, n in ((column, columns), (row, rows))]
    right, down = (np.arange(-each, each + 1.0, STEP_PX) for each in half)
    x, y = np.meshgrid(right, down)
    square = (x**2 + y**2) / FOCAL_PX[0] ** 2
    bent = 1.0 + DISTORTION[0] * square + DISTORTION[1] * square**2
    offset = 0.5 * (bin_px - 1)
    return _between(
        contrast, (row + bent * y - offset) / bin_px, (column + bent * x - offset) / bin_px
    )


def _between(values: F64, row: F64, column: F64) -> F64:
    """Return values between the points of an array, which ends at its last ones; bilinear."""
    row = np.clip(row, 0.0, values.shape[0] - 1.001)
    column = np.clip(column, 0.0, values.shape[1] - 1.001)
    i, j = row.astype(np.int64), column.astype(np.int64)
    u, v = row - i, column - j
    upper = values[i, j] * (1.0 - v) + values[i, j + 1] * v
    lower = values[i + 1, j] * (1.0 - v) + values[i + 1, j + 1] * v
    return np.asarray(upper * (1.0 - u) + lower * u)


def _smooth(picture: F64, width_px: float) -> F64:
    """Return a picture of `STEP_PX` under a Gaussian of this standard deviation."""
    side, width = 2 * round(3.0 * width_px / STEP_PX) + 1, width_px / STEP_PX
    return np.asarray(cv2.GaussianBlur(picture, (side, side), width), np.float64)


@lru_cache(maxsize=1)
def _lattices() -> tuple[NDArray[np.int64], tuple[F64, F64], tuple[F64, F64]]:
    """Return bands of the spectrum, places in it of all harmonics, and periods and angles."""
    along = np.abs(np.fft.fftfreq(SIZE, STEP_PX))
    bands = np.digitize(np.hypot(along[:, None], along), np.linspace(1.0 / 30.0, 1.0 / 5.0, 30))
    periods, angles = np.meshgrid(
        np.geomspace(*PERIODS_PX, 140), np.radians(np.arange(0.0, 90.0, 0.4)), indexing='ij'
    )
    cos, sin = np.cos(angles) / periods, np.sin(angles) / periods
    scale = SIZE * STEP_PX
    m, n = (np.array(each)[:, None, None] for each in zip(*HARMONICS, strict=True))
    rows, columns = (m * sin + n * cos) * scale % SIZE, (m * cos - n * sin) * scale % SIZE
    return bands, (rows, columns), (periods, angles)
