# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A jump of one clock within a recording, seen in the residuals of a refined fit."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

SPACING_S: Final = 0.5
"""Spacing of the moments at which a jump is looked for [s]."""


def largest_step(
    rows: NDArray[np.float64],
    residual: NDArray[np.float64],
    change: NDArray[np.float64],
    basis: NDArray[np.float64],
    t_s: NDArray[np.float64],
    noise_N: float,
) -> tuple[float, float, float]:
    """Return the jump that would explain most of the residuals.

    Args:
        rows: Design of the fit, weighted and without what the basis explains, ``[n, p]``.
        residual: What the fit left, weighted, ``[n]`` [N].
        change: Weighted change of the force with time, ``[n]`` [N/s].
        basis: Orthonormal weighted basis, ``[n, k]``.
        t_s: Time of each frame [s].
        noise_N: Standard deviation of the residuals [N].

    Returns:
        Jump [s], when [s], and how many standard deviations it is.
    """
    own = np.linalg.qr(rows)[0]
    best = (0.0, float(t_s[0]), 0.0)
    for at in np.arange(t_s[0] + 1.0, t_s[-1] - 1.0, SPACING_S):
        column = -change * (t_s > at)
        column -= basis @ (basis.T @ column)
        column -= own @ (own.T @ column)
        power = float(column @ column)
        if power < 1e-12:
            continue
        jump = float(column @ residual) / power
        deviations = abs(jump) * float(np.sqrt(power)) / noise_N
        if deviations > best[2]:
            best = (jump, float(at), deviations)
    return best
