# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Contact with an incompressible elastic layer bonded to a rigid base, without dimensions.

Frictionless axisymmetric contact leads to a dual integral equation for a function omega(x) on
0 <= x <= 1 (x in contact radii):

    omega(x) - int_0^1 K(x, y) omega(y) dy = depth - a^2 x^2 / R   (sphere; without x^2 if flat)
    K(x, y) = (2 alpha / pi) int_0^inf [1 - M(t)] cos(alpha x t) cos(alpha y t) dt
    M(t) = (sinh 2t - 2t) / (cosh 2t + 1 + 2 t^2),  alpha = contact radius / thickness

The sphere's depth follows from omega(1) = 0, the force is 2 a E* int omega dx with
E* = 4 E / 3. Nothing here has a unit, so the solution is shared by all sensors.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Literal

import numpy as np
from threadpoolctl import threadpool_limits

if TYPE_CHECKING:
    from numpy.typing import NDArray

ALPHA = np.concatenate([np.linspace(0.02, 0.3, 15), np.linspace(0.35, 2.5, 44)])
"""Grid of contact radius / layer thickness."""

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(128)
X = 0.5 * (_NODES + 1.0)
"""Gauss-Legendre nodes on the contact, x = r / a."""
X_WEIGHTS = 0.5 * _WEIGHTS


def surface_mobility(t: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return M(t), the layer's surface compliance relative to a half-space.

    Args:
        t: Wave number times thickness, non-negative.
    """
    small = t < 0.02
    u = np.clip(t, 0.02, 20.0)
    full = (np.sinh(2 * u) - 2 * u) / (np.cosh(2 * u) + 1 + 2 * u * u)
    return np.where(small, 2.0 / 3.0 * t**3, np.where(t > 20.0, 1.0, full))


def _resolvent(alpha: float, right: NDArray[np.float64]) -> NDArray[np.float64]:
    """Solve omega - K omega = right on the nodes and at x = 1 (last row)."""
    t, weights = 10.0 * (_NODES + 1.0), 10.0 * _WEIGHTS
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

    depth: NDArray[np.float64]
    load: NDArray[np.float64]
    omega: NDArray[np.float64]


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
