# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Displacement inside the bonded layer under an axisymmetric contact.

Hankel integrals of the bonded, incompressible layer (y up from the base, q = wave number * y,
t = wave number * thickness) with U(q) = A [q cosh q - sinh q] + B q sinh q and no shear at the
surface; the radial part follows from incompressibility, V = dU/dq. The pressure is the one of
the contact solution. Displacements are kept per unit of F / (E h), which has a limit (a point
load) for small contacts, so one table serves all sensors.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Literal

import numpy as np
from scipy.interpolate import RegularGridInterpolator
from scipy.special import j0, j1
from threadpoolctl import threadpool_limits

from mixtac_sim.layer_contact import ALPHA, X_WEIGHTS, X, solve_contact

if TYPE_CHECKING:
    from numpy.typing import NDArray

RADII = np.linspace(0.0, 6.0, 97)
"""Distance from the axis over the thickness."""
HEIGHTS = np.linspace(0.0, 1.0, 25)
"""Height above the base over the thickness; 1 is the skin."""

_WAVES = 80.0


@dataclass(frozen=True, slots=True)
class DisplacementField:
    """Displacement of one shape of indenter, in units of F / (E h).

    Attributes:
        inward: Displacement towards the base [contact radius, height, distance].
        outward: Displacement away from the axis, same shape.
    """

    inward: NDArray[np.float64]
    outward: NDArray[np.float64]

    def at(
        self, alpha: NDArray[np.float64], height: NDArray[np.float64], radius: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return inward and outward displacement at points of the undeformed layer.

        Args:
            alpha: Contact radius over thickness, clipped to 0.02 ... 2.5.
            height: Height above the base over thickness, clipped to 0 ... 1.
            radius: Distance from the axis over thickness; beyond 6 nothing moves.

        Returns:
            Displacements in units of F / (E h), broadcast over the arguments.
        """
        points = np.broadcast_arrays(
            np.clip(alpha, ALPHA[0], ALPHA[-1]), np.clip(height, 0.0, 1.0), radius
        )
        grid = (ALPHA, HEIGHTS, RADII)
        found = [
            RegularGridInterpolator(grid, table, bounds_error=False, fill_value=0.0)(
                np.stack(points, axis=-1)
            )
            for table in (self.inward, self.outward)
        ]
        return found[0], found[1]


@lru_cache(maxsize=2)
def displacement_field(shape: Literal['sphere', 'flat']) -> DisplacementField:
    """Return the tabulated field of a shape (computed once per process, below a second)."""
    # Sums of many threads differ in the last bit from those of one, and then trials do too.
    with threadpool_limits(limits=1, user_api='blas'):
        t, weights = _wave_numbers()
        load = _load_spectrum(shape, t) * weights * 3.0 / (4.0 * np.pi)
        inner, slope = depth_profiles(t, HEIGHTS)
        distances = np.outer(t, RADII)
        inward = _transform(load, inner, j0(distances))
        return DisplacementField(inward, _transform(load, slope, j1(distances)))


def _transform(
    load: NDArray[np.float64], profile: NDArray[np.float64], wave: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the sum over wave numbers for all contacts, heights and distances at once."""
    modes = profile[:, :, None] * wave[:, None, :]
    table = load @ modes.reshape(len(wave), -1)
    return np.asarray(table.reshape(len(load), *modes.shape[1:]))


def _wave_numbers() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return nodes and weights of a composite Gauss rule on 0 ... 80."""
    nodes, weights = np.polynomial.legendre.leggauss(16)
    starts, width = np.linspace(0.0, _WAVES, 101)[:-1], _WAVES / 100
    t = (starts[:, None] + width * 0.5 * (nodes + 1.0)).ravel()
    return t, np.tile(0.5 * width * weights, 100)


def _load_spectrum(shape: Literal['sphere', 'flat'], t: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the Hankel transform of the pressure over the force [alpha, t]."""
    contact = solve_contact(shape)
    spectrum = [
        (omega * X_WEIGHTS) @ np.cos(alpha * np.outer(X, t))
        for alpha, omega in zip(ALPHA, contact.omega, strict=True)
    ]
    return np.stack(spectrum) / contact.load[:, None]


def depth_profiles(
    t: NDArray[np.float64], height: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return U and dU/dq at heights for unit pressure [t, height], free of overflow."""
    t = t[:, None]
    q = t * height
    decay = np.exp(-t)
    cosh_t, sinh_t = 0.5 * (1.0 + decay**2), 0.5 * (1.0 - decay**2)  # times exp(-t)
    a, b = -(cosh_t + t * sinh_t), t * cosh_t
    rise, fall = np.exp(q - t), np.exp(-q - t)
    cosh_q, sinh_q = 0.5 * (rise + fall), 0.5 * (rise - fall)  # times exp(-t)
    scale = 2.0 / (0.5 * (1.0 + decay**4) + (1.0 + 2.0 * t * t) * decay**2)
    inner = a * (q * cosh_q - sinh_q) + b * q * sinh_q
    slope = a * q * sinh_q + b * (sinh_q + q * cosh_q)
    return scale * inner, scale * slope
