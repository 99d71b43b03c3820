# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
r"""Position, size and orientation of a contact on the skin.

A press moves the beads of a thin bonded layer away from the contact. A pull moves them in its own
direction, and moves those ahead of and behind the contact more than those beside it. The field of a
contact at :math:`c` is fitted as

.. math:: u(p) = \left[ a \, (1 + q)^{-3/2} + b k \, (d^T s) (1 + k q)^{-5/2} \right] M d
                 + s \, (1 + k q)^{-3/2}, \quad d = p - c, \quad q = d^T M d

by weighted least squares (Levenberg and Marquardt): the symmetric matrix :math:`M` holds the width
along each axis, :math:`s` is the displacement that shear and perspective add, and k (`SHEAR_FALL`)
and b (`SHEAR_LOBES`) give its shape. Weights are the structure tensors of the field: the fit is
then equivalent to a fit of the picture itself, and points without texture have no weight.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mixtac_fger.displacement import DisplacementField, FieldMeter, SkinScale, field_places
from mixtac_fger.features import Cells, bin_cells

if TYPE_CHECKING:
    from mixtac_fger.config import FgerConfig

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

PARAMETERS: Final = 8
"""a, s_x, s_y, c_x, c_y, M_xx, M_xy, M_yy."""
SHEAR_FALL: Final = 0.8
"""How fast shear and perspective fall off with q."""
SHEAR_LOBES: Final = 0.8
"""How much farther they reach along the pull than across it."""
START_MM: Final = 3.0
"""Width from which a fit begins [mm]."""
NARROWEST_MM: Final = 0.8
"""Smallest width of a fit [mm]."""
WIDEST_MM: Final = 12.0
"""Largest width of a fit [mm]."""
ROUND: Final = 0.3
"""Standard deviation of the logarithm of the ratio of the widths, before any measurement."""
REACH_MM: Final = (14.0, 11.0)
"""Largest distance of a contact from the axis, x and y [mm]: about what the camera sees."""
SIGNIFICANT: Final = 10.0
"""Standard deviations from which on a picture shows a contact; 7.7 is the largest at rest."""
PLACE_DEVIATION_MM: Final = 0.14
"""Standard deviation of the place per axis [mm] that the arrangement of the beads makes."""
SHEAR_DEVIATION: Final = 0.13
"""The same over s / (a M): how far a pull moves the place of a press."""
CARRY_RIDGE: Final = 0.03
"""Regularisation over the diagonal of the normal matrix by which events change a contact."""
KNOWN_OBJECT: Final = (0.4127, 0.1427, 0.3455, 0.3258)
"""Logarithm of the contact's radius [mm] by those of width, steepness and radius of the object."""
UNKNOWN_OBJECT: Final = (3.1956, -3.886, 1.0024, 1.8178, 0.0646, -0.462)
"""The same by width and steepness, their squares and their product."""


ITERATIONS: Final = 25
"""Most steps of a fit."""
DONE_MM: Final = 2e-3
"""Change of the place at which a fit ends [mm]."""
MOST_DAMPING: Final = 1e6
"""Damping at which a fit ends."""
LEAST_DIAGONAL: Final = 1e-12
"""Added to the diagonal of the normal matrix."""


@njit(cache=True, nogil=True)
def _slopes(dx: float, dy: float, p: F64, model: F64, slopes: F64) -> None:
    """Write the displacement [2] at a distance from the contact and its derivatives [2, 8]."""
    mx, my = p[5] * dx + p[6] * dy, p[6] * dx + p[7] * dy
    q = dx * mx + dy * my
    press, fall = 1.0 / (1.0 + q), 1.0 / (1.0 + SHEAR_FALL * q)
    g, e = press * np.sqrt(press), fall * np.sqrt(fall)
    lobe = SHEAR_LOBES * SHEAR_FALL * fall * e
    ahead = dx * p[1] + dy * p[2]
    # u = drive M d + s e; the changes are those per q.
    drive = p[0] * g + ahead * lobe
    drive_change = -1.5 * p[0] * g * press - 2.5 * SHEAR_FALL * ahead * lobe * fall
    e_change = -1.5 * SHEAR_FALL * e * fall
    for axis in range(2):
        m = mx if axis == 0 else my
        along, across = (p[5], p[6]) if axis == 0 else (p[6], p[7])
        change = drive_change * m + e_change * p[1 + axis]
        model[axis] = drive * m + p[1 + axis] * e
        slopes[axis, 0] = m * g
        slopes[axis, 1] = dx * lobe * m + (e if axis == 0 else 0.0)
        slopes[axis, 2] = dy * lobe * m + (e if axis == 1 else 0.0)
        slopes[axis, 3] = -(drive * along + 2.0 * change * mx + lobe * p[1] * m)
        slopes[axis, 4] = -(drive * across + 2.0 * change * my + lobe * p[2] * m)
        slopes[axis, 5] = change * dx * dx + (drive * dx if axis == 0 else 0.0)
        slopes[axis, 6] = 2.0 * change * dx * dy + drive * (dy if axis == 0 else dx)
        slopes[axis, 7] = change * dy * dy + (drive * dy if axis == 1 else 0.0)


@njit(cache=True, nogil=True)
def _normal(places: F32, moved: F32, tensor: F32, p: F64, normal: F64, right: F64) -> float:
    """Write the normal equations of a step at parameters `p`; return the weighted square left."""
    normal[:] = 0.0
    right[:] = 0.0
    square = 0.0
    model, slopes = np.empty(2), np.empty((2, PARAMETERS))
    for row in range(places.shape[1]):
        for column in range(places.shape[2]):
            _slopes(places[0, row, column] - p[3], places[1, row, column] - p[4], p, model, slopes)
            xx, xy, yy = tensor[0, row, column], tensor[1, row, column], tensor[2, row, column]
            rx, ry = moved[0, row, column] - model[0], moved[1, row, column] - model[1]
            wx, wy = xx * rx + xy * ry, xy * rx + yy * ry
            square += rx * wx + ry * wy
            for i in range(PARAMETERS):
                right[i] += slopes[0, i] * wx + slopes[1, i] * wy
                ax = xx * slopes[0, i] + xy * slopes[1, i]
                ay = xy * slopes[0, i] + yy * slopes[1, i]
                for j in range(i + 1):
                    normal[i, j] += ax * slopes[0, j] + ay * slopes[1, j]
    for i in range(PARAMETERS):
        for j in range(i):
            normal[j, i] = normal[i, j]
    # A prior for a round contact.
    trace = p[5] + p[7]
    if trace > 0.0:
        uneven, skew = (p[5] - p[7]) / (trace * ROUND), 2.0 * p[6] / (trace * ROUND)
        per = 1.0 / (trace * ROUND)
        square += uneven * uneven + skew * skew
        right[5] -= uneven * per
        right[7] += uneven * per
        right[6] -= 2.0 * skew * per
        normal[5, 5] += per * per
        normal[7, 7] += per * per
        normal[5, 7] -= per * per
        normal[7, 5] -= per * per
        normal[6, 6] += 4.0 * per * per
    return square


@njit(cache=True, nogil=True)
def _damped(matrix: F64, damping: float) -> F64:
    """Return a normal matrix with a larger diagonal, which is positive even without texture."""
    return matrix + np.diag(damping * np.diag(matrix) + LEAST_DIAGONAL)


@njit(cache=True, nogil=True)
def is_sensible(p: F64) -> bool:
    """Return whether parameters describe a contact within reach."""
    trace, determinant = p[5] + p[7], p[5] * p[7] - p[6] * p[6]
    if not determinant > 0.0 or not trace > 0.0:
        return False
    root = np.sqrt(max(0.25 * trace * trace - determinant, 0.0))
    low, high = 0.5 * trace - root, 0.5 * trace + root
    inside = abs(p[3]) < REACH_MM[0] and abs(p[4]) < REACH_MM[1]
    return bool(inside and low * WIDEST_MM**2 > 1.0 and high * NARROWEST_MM**2 < 1.0)


@njit(cache=True, nogil=True)
def _search(places: F32, moved: F32, tensor: F32, p: F64) -> None:
    """Write a and place of the round contact on a coarse grid that explains most."""
    best, per = 0.0, 1.0 / (START_MM * START_MM)
    p[:] = 0.0
    p[0], p[5], p[7] = 1e-3, per, per
    for i in range(-6, 7):
        for j in range(-5, 6):
            cx, cy, both, own = 1.5 * i, 1.5 * j, 0.0, 1e-12
            for row in range(0, places.shape[1], 2):
                for column in range(0, places.shape[2], 2):
                    dx, dy = places[0, row, column] - cx, places[1, row, column] - cy
                    q = 1.0 / (1.0 + per * (dx * dx + dy * dy))
                    g = per * q * np.sqrt(q)
                    xx, xy = tensor[0, row, column], tensor[1, row, column]
                    yy = tensor[2, row, column]
                    wx, wy = (xx * dx + xy * dy) * g, (xy * dx + yy * dy) * g
                    both += wx * moved[0, row, column] + wy * moved[1, row, column]
                    own += (wx * dx + wy * dy) * g
            if both > 0.0 and both * both / own > best:
                best = both * both / own
                p[0], p[3], p[4] = both / own, cx, cy


@njit(cache=True, nogil=True)
def _fit(
    places: F32, moved: F32, tensor: F32, anew: bool, p: F64, covariance: F64
) -> tuple[float, float]:
    """Fit from `p`, or from a search; write parameters and covariance.

    Returns:
        Weighted square of the field, and of the residual of the fit.
    """
    shape = PARAMETERS, PARAMETERS
    normal, right = np.empty(shape), np.empty(PARAMETERS)
    at, push = np.empty(shape), np.empty(PARAMETERS)
    whole = _normal(places, moved, tensor, np.zeros(PARAMETERS), normal, right)
    if anew:
        _search(places, moved, tensor, p)
    left = _normal(places, moved, tensor, p, at, push)
    damping = 1e-3
    for _ in range(ITERATIONS):
        step = np.linalg.solve(_damped(at, damping), push)
        tried, now = p + step, np.inf
        if is_sensible(tried):
            now = _normal(places, moved, tensor, tried, normal, right)
        if now < left:
            done = abs(step[3]) + abs(step[4]) < DONE_MM and left - now < 1e-3 * left
            p[:], at[:], push[:] = tried, normal, right
            left, damping = now, max(0.2 * damping, 1e-7)
            if done:
                break
        else:
            damping = 10.0 * damping
            if damping > MOST_DAMPING:
                break
    covariance[:] = np.linalg.inv(_damped(at, 1e-9))
    return whole, left


@njit(cache=True, nogil=True)
def _cell_slopes(places: F32, tensor: F32, p: F64, cells: Cells, slopes: F64, tensors: F64) -> None:
    """Add the derivatives [rows, columns, 2, 8] and tensors [.., 3] of the points of cells."""
    model, here = np.empty(2), np.empty((2, PARAMETERS))
    for row in range(places.shape[1]):
        for column in range(places.shape[2]):
            _slopes(places[0, row, column] - p[3], places[1, row, column] - p[4], p, model, here)
            i, j = cells[0][row], cells[1][column]
            for axis in range(2):
                for k in range(PARAMETERS):
                    slopes[i, j, axis, k] += here[axis, k]
            for k in range(3):
                tensors[i, j, k] += tensor[k, row, column]


def cell_gains(places: F32, tensor: F32, p: F64, grid: tuple[int, int]) -> F64:
    """Return how parameters follow the mean displacement of cells, float64 [8, rows, columns, 2].

    Least squares about the parameters, with a ridge: parameters that the cells do not show stay.

    Args:
        places: Of the points of a field [mm], float32 [2, rows, columns].
        tensor: Their weights, float32 [3, rows, columns].
        p: Parameters.
        grid: Rows and columns of cells.
    """
    slopes, tensors = np.zeros((*grid, 2, PARAMETERS)), np.zeros((*grid, 3))
    rows, columns = bin_cells(places.shape[1:], grid)
    _cell_slopes(places, tensor, p, (rows, columns), slopes, tensors)
    slopes /= np.outer(np.bincount(rows), np.bincount(columns))[..., None, None]
    weights = tensors[..., [[0, 1], [1, 2]]]
    weighted = np.einsum('rcai,rcab->ircb', slopes, weights)
    normal = np.einsum('ircb,rcbj->ij', weighted, slopes)
    diagonal = np.diag_indices(PARAMETERS)
    normal[diagonal] *= 1.0 + CARRY_RIDGE
    # A picture without texture makes the matrix singular.
    normal[diagonal] += 1e-12 * max(float(np.trace(normal)), 1.0)
    return np.linalg.solve(normal, weighted.reshape(PARAMETERS, -1)).reshape(weighted.shape)


@dataclass(frozen=True, slots=True, eq=False)
class ContactFit:
    """A contact fitted to a displacement field, in the contact frame.

    Attributes:
        parameters: a [mm^2], s [mm], c [mm], M [1/mm^2]; see the module.
        covariance: Of these, float64 [8, 8], for the noise of the picture.
        significance: Square root of the ratio of the explained to the unexplained part of the
            field: standard deviations of the noise. Below `SIGNIFICANT` there is no contact to be
            seen.
        gains: Change of the parameters per displacement of each cell of the event grid, right and
            down in the image [.../px], float64 [8, rows, columns, 2].
    """

    parameters: F64
    covariance: F64
    significance: float
    gains: F64

    @property
    def seen(self) -> bool:
        """Whether the picture shows a contact."""
        return self.significance > SIGNIFICANT and self.parameters[0] > 0.0


class ContactShape(NamedTuple):
    """Place and shape of a contact, in the contact frame.

    Attributes:
        x_mm: Place to the right in the image [mm].
        y_mm: Place upwards in the image [mm].
        deviation_mm: Standard deviation of the place per axis [mm].
        area_mm2: Area [mm^2].
        area_deviation_mm2: Its standard deviation [mm^2].
        major_mm: Larger semi-axis of the ellipse [mm].
        minor_mm: Smaller semi-axis [mm].
        angle: From x to the larger axis [rad], in (-pi/2, pi/2].
    """

    x_mm: float
    y_mm: float
    deviation_mm: float
    area_mm2: float
    area_deviation_mm2: float
    major_mm: float
    minor_mm: float
    angle: float


def contact_shape(p: F64, covariance: F64, scale: SkinScale, object_radius: float) -> ContactShape:
    """Return the place and shape that follow from the parameters of a fit.

    Args:
        p: Parameters [8].
        covariance: Of these [8, 8].
        scale: Of the skin in the picture.
        object_radius: Radius of curvature of what touches [mm]; 0 if it is not known.
    """
    strength, right, up, x, y, xx, xy, yy = p.tolist()
    mean, half = 0.5 * (xx + yy), math.hypot(0.5 * (xx - yy), xy)
    narrow, wide = (max(mean + sign * half, 1e-3) ** -0.5 for sign in (1.0, -1.0))
    angle = 0.5 * math.atan2(-2.0 * xy, yy - xx)
    radius, spread = contact_radius(math.sqrt(wide * narrow), strength, object_radius)
    ratio = math.sqrt(wide / narrow)
    sheared = math.hypot(right, up) / max(strength * mean, 1e-3)
    place = math.sqrt(
        0.5 * (covariance[3, 3] + covariance[4, 4])
        + PLACE_DEVIATION_MM**2
        + (SHEAR_DEVIATION * sheared) ** 2
        + 0.5 * scale.deviation**2 * (x**2 + y**2)
    )
    area = math.pi * radius**2
    return ContactShape(
        x_mm=x,
        y_mm=y,
        deviation_mm=place,
        area_mm2=area,
        area_deviation_mm2=area * math.hypot(spread, 2.0 * scale.deviation),
        major_mm=radius * ratio,
        minor_mm=radius / ratio,
        angle=angle,
    )


def contact_radius(
    width_mm: float, strength_mm2: float, object_radius: float
) -> tuple[float, float]:
    """Return the radius of a contact [mm], and the relative standard deviation of its area.

    Laws by least squares over 40 simulated sensors (`paper_like`, seeds from 800100 on; in turn
    under spheres of 9 and 4 mm and a flat face of 5 mm) at forces from 0.03 to 1 N.

    Args:
        width_mm: Geometric mean of the widths of the displacement field.
        strength_mm2: Its a.
        object_radius: Radius of curvature of what touches [mm]; 0 if it is not known.
    """
    width, steep = math.log(width_mm), math.log(max(strength_mm2, 1e-4) / width_mm)
    known = object_radius > 0.0
    more = (math.log(object_radius),) if known else (width**2, steep**2, width * steep)
    law, spread = (KNOWN_OBJECT, 0.15) if known else (UNKNOWN_OBJECT, 0.3)
    terms = (1.0, width, steep, *more)
    radius = math.exp(sum(factor * term for factor, term in zip(law, terms, strict=True)))
    return min(max(radius, NARROWEST_MM / 4.0), WIDEST_MM), spread


class Touch(NamedTuple):
    """The contact in a frame.

    Attributes:
        field: Displacement of the beads.
        fit: The contact that explains it best.
    """

    field: DisplacementField
    fit: ContactFit


class TouchMeter:
    """Measures displacement and contact of frames; each fit starts from the result of the last one.

    One instance per thread.

    Args:
        config: How frames become log contrasts, and the event grid.
        scale: Of the skin in the picture.
    """

    def __init__(self, config: FgerConfig, scale: SkinScale) -> None:
        self._meter = FieldMeter(config)
        self._size, self._grid = (config.width, config.height), config.grid_shape
        self._scale, self._parameters = scale, np.zeros(PARAMETERS)
        self._seen = False

    def measure(self, reference: F32, image: F32) -> Touch:
        """Return the displacement of a picture and the contact in it.

        Args:
            reference: Coarse log contrast without contact, float32 `FgerConfig.frame_shape`.
            image: Coarse log contrast now, same shape.
        """
        field = self._meter.measure(reference, image)
        return Touch(field, self.fit(field))

    def fit(self, field: DisplacementField) -> ContactFit:
        """Return the contact that explains a field best, or what looks most like one.

        Args:
            field: Displacement since the reference.
        """
        shape = field.moved.shape[1:]
        places = field_places((shape[0], shape[1]), field.spacing_px, self._scale, self._size)
        px = np.float32(self._scale.px_per_mm)
        # Rows count downwards, y upwards.
        moved = field.moved * np.array([1.0 / px, -1.0 / px], np.float32)[:, None, None]
        bins = (field.spacing_px / field.bin_px) ** 2
        weight = np.float32(bins * (field.bin_px * px / max(field.noise, 1e-4)) ** 2)
        signs = np.array([weight, -weight, weight], np.float32)[:, None, None]
        tensor = field.tensor * signs
        covariance = np.empty((PARAMETERS, PARAMETERS))
        whole, left = _fit(places, moved, tensor, not self._seen, self._parameters, covariance)
        degrees = max(left / moved.size, 1.0)
        significance = math.sqrt(max(whole - left, 0.0) / degrees)
        gains = cell_gains(places, tensor, self._parameters, self._grid)
        gains *= np.array([1.0 / px, -1.0 / px])
        fit = ContactFit(self._parameters.copy(), degrees * covariance, significance, gains)
        self._seen = fit.seen
        return fit
