# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Contact with an incompressible elastic layer bonded to a rigid base.

Round bodies. Frictionless axisymmetric contact leads to a dual integral equation for a function
omega(x) on 0 <= x <= 1 (x in contact radii):

    omega(x) - int_0^1 K(x, y) omega(y) dy = depth - a^2 x^2 / R   (sphere; without x^2 if flat)
    K(x, y) = (2 alpha / pi) int_0^inf [1 - M(t)] cos(alpha x t) cos(alpha y t) dt
    M(t) = (sinh 2t - 2t) / (cosh 2t + 1 + 2 t^2),  alpha = contact radius / thickness

The sphere's depth follows from omega(1) = 0, the force is 2 a E* int omega dx with E* = 4 E / 3.
This solution has no dimensions and is shared by all sensors.

Displacements inside the layer are Hankel integrals (y up from the base, q = wave number * y,
t = wave number * thickness) with U(q) = A [q cosh q - sinh q] + B q sinh q and no shear at the
surface; the radial part follows from incompressibility, V = dU/dq. They are kept per unit of
F / (E h), which has a limit (a point load) for small contacts, so one table serves all sensors.

A pull has the traction of a disc that sticks, F / (2 pi a sqrt(a^2 - r^2)). Along a wave the layer
moves as above, with a pull and no pressure at the skin; across it, by sinh q / (t cosh t). Summed
over all directions, both leave the Bessel functions J0 and J2, and J1 along the normal. A turn of
the disc (Reissner and Sagoci 1944) moves the layer across its waves only.

Rounded edges have no axis of symmetry: pressure and surface lie on a grid and the layer's response
is taken in wave space, u(k) = 2 (1 - nu^2) / (E k) M(k h) p(k). Pressures that do not pull are
found by the conjugate gradients of Polonsky and Keer (1999), per kPa of modulus.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft2, rfft2
from scipy.interpolate import RegularGridInterpolator
from scipy.ndimage import map_coordinates
from scipy.special import j0, j1, jv, spherical_jn
from threadpoolctl import threadpool_limits

from mixtac_core.events.arrays import Floats
from mixtac_sim import SimulationError

ALPHA = np.concatenate([np.linspace(0.02, 0.3, 15), np.linspace(0.35, 2.5, 44)])
"""Grid of contact radius / layer thickness."""
GAUSS = np.polynomial.legendre.leggauss(128)
"""Gauss-Legendre nodes and weights on -1 ... 1 [2, 128]."""
X = 0.5 * (GAUSS[0] + 1.0)
"""Nodes on the contact, x = r / a."""
X_WEIGHTS = 0.5 * GAUSS[1]
"""Weights of `X`."""


def surface_mobility(t: Floats) -> Floats:
    """Return M(t), the layer's surface compliance relative to a half-space.

    Args:
        t: Wave number times thickness, non-negative.
    """
    small = t < 0.02
    u = np.clip(t, 0.02, 20.0)
    full = (np.sinh(2 * u) - 2 * u) / (np.cosh(2 * u) + 1 + 2 * u * u)
    return np.where(small, 2.0 / 3.0 * t**3, np.where(t > 20.0, 1.0, full))


def _resolvent(alpha: float, right: Floats) -> Floats:
    """Solve omega - K omega = right on the nodes and at x = 1 (last row)."""
    t, weights = 10.0 * (GAUSS[0] + 1.0), 10.0 * GAUSS[1]
    lost = weights * (1.0 - surface_mobility(t))
    rows = np.cos(alpha * np.outer(np.append(X, 1.0), t))
    kernel = (2.0 * alpha / np.pi) * (rows * lost) @ rows[:-1].T * X_WEIGHTS
    inner = np.linalg.solve(np.eye(len(X)) - kernel[:-1], right[:-1])
    return np.vstack([inner, right[-1:] + kernel[-1:] @ inner])


@dataclass(frozen=True, slots=True)
class ContactSolution:
    """Contact of one shape for every contact radius of ``ALPHA``.

    Lengths are in units of a^2 / R for the sphere and of the depth for the flat face.

    Attributes:
        depth: Depth of indentation [59].
        load: int omega dx [59], the force over 2 a E* times the unit of length.
        omega: omega on the nodes ``X`` [59, 128].
    """

    depth: Floats
    load: Floats
    omega: Floats


@lru_cache(maxsize=2)
def solve_contact(shape: Literal['sphere', 'flat']) -> ContactSolution:
    """Return the contact of a sphere or of a flat face for all of ``ALPHA``."""
    x = np.append(X, 1.0)
    right = np.stack([np.ones_like(x), x * x], axis=1)
    # Sums of many threads differ in the last bit from those of one, and then trials do too.
    with threadpool_limits(limits=1, user_api='blas'):
        solutions = [_resolvent(float(alpha), right) for alpha in ALPHA]
    uniform = np.stack([s[:, 0] for s in solutions])
    if shape == 'flat':
        omega, depth = uniform, np.ones(len(ALPHA))
    else:
        square = np.stack([s[:, 1] for s in solutions])
        depth = square[:, -1] / uniform[:, -1]
        omega = depth[:, None] * uniform - square
    return ContactSolution(depth, omega[:, :-1] @ X_WEIGHTS, omega[:, :-1])


def punch_factor(alpha: float) -> float:
    """Return the stiffness of a flat face on the layer over that on a half-space, kappa(a / h)."""
    return float(np.interp(alpha, ALPHA, solve_contact('flat').load))


FIELD_RADII = np.linspace(0.0, 6.0, 97)
"""Distance from the axis over the thickness."""
FIELD_HEIGHTS = np.linspace(0.0, 1.0, 25)
"""Height above the base over the thickness; 1 is the skin."""
_WAVES = 80.0


@dataclass(frozen=True, slots=True)
class LayerField:
    """Tabulated motion of the layer under a contact.

    Attributes:
        table: Values [contact radius, height, distance, value].
    """

    table: Floats

    def at(self, alpha: Floats, height: Floats, radius: Floats) -> Floats:
        """Return the values at points of the undeformed layer, broadcast, [..., value].

        Args:
            alpha: Contact radius over thickness, clipped to 0.02 ... 2.5.
            height: Height above the base over thickness, clipped to 0 ... 1.
            radius: Distance from the axis over thickness; beyond 6 nothing moves.
        """
        points = np.broadcast_arrays(
            np.clip(alpha, ALPHA[0], ALPHA[-1]), np.clip(height, 0.0, 1.0), radius
        )
        grid = (ALPHA, FIELD_HEIGHTS, FIELD_RADII)
        found = RegularGridInterpolator(grid, self.table, bounds_error=False, fill_value=0.0)
        return np.asarray(found(np.stack(points, axis=-1)))


@lru_cache(maxsize=2)
def displacement_field(shape: Literal['sphere', 'flat']) -> LayerField:
    """Return displacements inwards and away from the axis, in units of F / (E h).

    Computed once per process and shape, in less than a second.
    """
    # Sums of many threads differ in the last bit from those of one, and then trials do too.
    with threadpool_limits(limits=1, user_api='blas'):
        t, weights = _wave_numbers()
        load = _load_spectrum(shape, t) * weights * 3.0 / (4.0 * np.pi)
        inner, slope, _ = depth_profiles(t, FIELD_HEIGHTS, pulled=False)
        distances = np.outer(t, FIELD_RADII)
        tables = _transform(load, inner, j0(distances)), _transform(load, slope, j1(distances))
        return LayerField(np.stack(tables, axis=-1))


def _transform(load: Floats, profile: Floats, wave: Floats) -> Floats:
    """Return the sum over wave numbers for all contacts, heights and distances at once."""
    modes = profile[:, :, None] * wave[:, None, :]
    table = load @ modes.reshape(len(wave), -1)
    return np.asarray(table.reshape(len(load), *modes.shape[1:]))


def _wave_numbers() -> tuple[Floats, Floats]:
    """Return nodes and weights of a composite Gauss rule on 0 ... 80."""
    nodes, weights = np.polynomial.legendre.leggauss(16)
    starts, width = np.linspace(0.0, _WAVES, 101)[:-1], _WAVES / 100
    t = (starts[:, None] + width * 0.5 * (nodes + 1.0)).ravel()
    return t, np.tile(0.5 * width * weights, 100)


def _load_spectrum(shape: Literal['sphere', 'flat'], t: Floats) -> Floats:
    """Return the Hankel transform of the pressure over the force [alpha, t]."""
    contact = solve_contact(shape)
    spectrum = [
        (omega * X_WEIGHTS) @ np.cos(alpha * np.outer(X, t))
        for alpha, omega in zip(ALPHA, contact.omega, strict=True)
    ]
    return np.stack(spectrum) / contact.load[:, None]


def depth_profiles(t: Floats, height: Floats, *, pulled: bool) -> tuple[Floats, Floats, Floats]:
    """Return how a wave moves the layer at heights, free of overflow.

    Args:
        t: Wave number times thickness, positive [t].
        height: Height above the base over the thickness [height].
        pulled: By a unit pull at the skin, in units of h / G; else by a unit pressure.

    Returns:
        U and dU/dq, and the displacement across the wave for a pull across it [t, height]. By a
        pull, U is the rise, a quarter of the wave ahead, and dU/dq the displacement along the wave.
    """
    t = t[:, None]
    q, decay = t * height, np.exp(-t)
    cosh_t, sinh_t = 0.5 * (1.0 + decay**2), 0.5 * (1.0 - decay**2)  # times exp(-t)
    rise, fall = np.exp(q - t), np.exp(-q - t)
    cosh_q, sinh_q = 0.5 * (rise + fall), 0.5 * (rise - fall)  # times exp(-t)
    whole = 0.5 * (1.0 + decay**4) + (1.0 + 2.0 * t * t) * decay**2
    # At the skin: no pressure and a pull of one, or no pull.
    a, b = (cosh_t, cosh_t / t - sinh_t) if pulled else (-(cosh_t + t * sinh_t), t * cosh_t)
    inner = a * (q * cosh_q - sinh_q) + b * q * sinh_q
    slope = a * q * sinh_q + b * (sinh_q + q * cosh_q)
    scale = (1.0 if pulled else 2.0) / whole
    return scale * inner, scale * slope, sinh_q / (t * cosh_t)


@lru_cache(maxsize=1)
def shear_field() -> LayerField:
    """Return the motion of the layer by a pull at the skin, and by a turn.

    The values are the mean displacement along the pull; half the difference between displacements
    along the line of the pull and beside it; the rise ahead of it, all in units of F / (2 pi G h);
    and the turn over that of the disc. Computed once per process, in a second.
    """
    with threadpool_limits(limits=1, user_api='blas'):
        t, weights = _wave_numbers()
        rise, along, across = depth_profiles(t, FIELD_HEIGHTS, pulled=True)
        size = np.outer(ALPHA, t)
        pull = np.sinc(size / np.pi) * t * weights
        distances = np.outer(t, FIELD_RADII)
        zero, one, two = j0(distances), j1(distances), jv(2, distances)
        # J1(t r) / r, with its limit on the axis.
        turned = np.divide(one, FIELD_RADII, out=0.5 * t[:, None] + 0.0 * one, where=one != 0.0)
        spin = 4.0 / np.pi * ALPHA[:, None] ** 2 * spherical_jn(1, size) * weights
        tables = (
            _transform(pull, 0.5 * (across + along), zero),
            _transform(pull, 0.5 * (across - along), two),
            _transform(pull, rise, one),
            _transform(spin, across * t[:, None], turned),
        )
        return LayerField(np.stack(tables, axis=-1))


SHAPE = (240, 96)
"""Grid across and along the edge."""
CELL_MM = (0.1, 0.25)
"""Size of its cells [mm]: the contact is one or two millimetres wide."""
ROWS = 20
"""Depths that are solved, from 0 on in a quadratic progression."""
DEEPEST = 0.4
"""Largest depth over the thickness; twice the trials' largest force is below it."""
HEIGHTS = np.linspace(0.0, 1.0, 13)
"""Heights above the base over the thickness at which the field is kept."""
ACCURACY = 1e-3
"""Largest error of the surface over the depth at which the search ends."""
SEARCHES = 400
"""Steps after which a search has failed."""


class _Waves(NamedTuple):
    """Wave numbers of the grid.

    Attributes:
        across: Wave number of each row [n, 1] [1/mm].
        along: Wave number of each column [1, m] [1/mm].
        size: Length of the wave vector [n, m] [1/mm], 1 instead of 0.
        compliance: Surface displacement over pressure [n, m] [mm/kPa at 1 kPa modulus].
    """

    across: Floats
    along: Floats
    size: Floats
    compliance: Floats


@dataclass(frozen=True, slots=True)
class EdgeContact:
    """An edge on a layer at ``ROWS`` depths.

    Attributes:
        thickness_mm: Thickness of the layer [mm].
        depth_mm: Depths [20] [mm].
        force_n: Forces per kPa of modulus [20] [N].
        radius_mm: Radius of the circle as large as the contact [20] [mm].
        spectra: Pressures in wave space per kPa of modulus [20, 240, 49].
    """

    thickness_mm: float
    depth_mm: Floats
    force_n: Floats
    radius_mm: Floats
    spectra: NDArray[np.complex128]

    def displacements(self, x_mm: Floats, y_mm: Floats, height: Floats) -> Floats:
        """Return displacements along, across and inwards [20, n, 3] [mm] at points of the layer.

        Args:
            x_mm: Place along the edge, from its middle [n] [mm].
            y_mm: Place across it [n] [mm].
            height: Height above the base over the thickness [n].
        """
        waves = _waves(self.thickness_mm)
        sizes = (waves.size * self.thickness_mm).ravel()
        inner, slope, _ = depth_profiles(sizes, HEIGHTS, pulled=False)
        shape = (*waves.size.shape, len(HEIGHTS))
        soft = (1.5 / waves.size)[:, :, None]
        inward, outward = soft * inner.reshape(shape), soft * slope.reshape(shape)
        inward[0, 0] = outward[0, 0] = 0.0
        turn = (-1j / waves.size)[:, :, None] * outward
        modes = (turn * waves.along[:, :, None], turn * waves.across[:, :, None], inward)
        place = np.stack(
            [
                height * (len(HEIGHTS) - 1),
                np.clip(y_mm / CELL_MM[0] + SHAPE[0] // 2, 0, SHAPE[0] - 1),
                np.clip(x_mm / CELL_MM[1] + SHAPE[1] // 2, 0, SHAPE[1] - 1),
            ]
        )
        moved = np.empty((ROWS, len(x_mm), 3))
        for row, spectrum in enumerate(self.spectra):
            for axis, mode in enumerate(modes):
                field = irfft2(np.moveaxis(spectrum[:, :, None] * mode, -1, 0), SHAPE)
                moved[row, :, axis] = map_coordinates(field, place, order=1)
        return moved


@lru_cache(maxsize=8)
def solve_edge(radius_mm: float, length_mm: float, thickness_mm: float) -> EdgeContact:
    """Return the contact of an edge with a layer (below 2 s, once per edge and layer).

    Args:
        radius_mm: Radius of the edge's rounding [mm].
        length_mm: Length of the edge [mm].
        thickness_mm: Thickness of the layer [mm].

    Raises:
        SimulationError: The search for the pressures did not end.
    """
    gap, waves = _gap(radius_mm, length_mm), _waves(thickness_mm)
    depths = DEEPEST * thickness_mm * np.linspace(0.0, 1.0, ROWS) ** 2
    pressure, cell = np.zeros(SHAPE), CELL_MM[0] * CELL_MM[1]
    force, area, spectra = np.zeros(ROWS), np.zeros(ROWS), []
    for row, depth in enumerate(depths):
        if row:
            pressure = _press(pressure, gap - depth, waves.compliance, float(depth))
        force[row] = 1e-3 * cell * pressure.sum()
        area[row] = cell * np.count_nonzero(pressure)
        spectra.append(rfft2(pressure))
    radius = np.sqrt(area / np.pi)
    return EdgeContact(thickness_mm, depths, force, radius, np.stack(spectra))


def _gap(radius_mm: float, length_mm: float) -> Floats:
    """Return how far the edge is from the skin at first touch [240, 96] [mm]."""
    across = CELL_MM[0] * (np.arange(SHAPE[0]) - SHAPE[0] // 2)
    along = CELL_MM[1] * (np.arange(SHAPE[1]) - SHAPE[1] // 2)
    beyond = np.maximum(np.abs(along) - 0.5 * length_mm, 0.0)
    return np.asarray((across[:, None] ** 2 + beyond**2) / (2.0 * radius_mm))


def _waves(thickness_mm: float) -> _Waves:
    across = np.asarray(2.0 * np.pi * np.fft.fftfreq(SHAPE[0], CELL_MM[0])[:, None], np.float64)
    along = np.asarray(2.0 * np.pi * np.fft.rfftfreq(SHAPE[1], CELL_MM[1])[None, :], np.float64)
    size = np.hypot(across, along)
    size[0, 0] = 1.0
    compliance = 1.5 / size * surface_mobility(size * thickness_mm)
    compliance[0, 0] = 0.0
    return _Waves(across, along, size, compliance)


def _press(pressure: Floats, open_mm: Floats, compliance: Floats, depth_mm: float) -> Floats:
    """Return the pressures [kPa at 1 kPa modulus] that close the gap without a pull.

    Args:
        pressure: Start of the search.
        open_mm: Gap that is left when the skin does not move, negative where it must [mm].
        compliance: Compliance of ``_Waves``.
        depth_mm: Depth [mm].
    """
    pressure = np.where(open_mm < 0.0, np.maximum(pressure, 1e-3), 0.0)
    way, before, kept = np.zeros(SHAPE), 1.0, 0.0
    for _ in range(SEARCHES):
        touching = pressure > 0.0
        gap = irfft2(rfft2(pressure) * compliance, SHAPE) + open_mm
        if np.abs(gap[touching]).max() < ACCURACY * depth_mm and gap.min() > -ACCURACY * depth_mm:
            return pressure
        square = float(np.sum(gap[touching] ** 2))
        way = np.where(touching, gap + kept * square / before * way, 0.0)
        before = square
        bent = irfft2(rfft2(way) * compliance, SHAPE)
        step = float(np.sum(gap[touching] * way[touching]) / np.sum(bent[touching] * way[touching]))
        pressure = np.where(touching, np.maximum(pressure - step * way, 0.0), 0.0)
        inside = (pressure == 0.0) & (gap < 0.0)
        kept = 0.0 if inside.any() else 1.0
        pressure[inside] -= step * gap[inside]
    msg = f'no pressures found for an edge at {depth_mm:.2f} mm; choose a rounder or shorter one'
    raise SimulationError(msg)
