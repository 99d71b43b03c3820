# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The moments of a trial that are worth a look."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

SMOOTHING_MS: Final = 20
APART_S: Final = 0.15
CONTACT_N: Final = 0.02
EDGE_S: Final = 1.1
"""Begin and end of a trial belong to the synchronising impulses."""


@dataclass(frozen=True, slots=True)
class Moment:
    """A named moment.

    Attributes:
        name: What happens.
        t_us: When [us, true time].
    """

    name: str
    t_us: int


def find_moments(t_us: NDArray[np.int64], force_n: NDArray[np.float64]) -> list[Moment]:
    """Return rest, fastest rise, largest force, fastest fall and the typical force, in order.

    Moments that would lie close to one that was found before are left out.

    Args:
        t_us: True time [n] [us], 1 kHz.
        force_n: True normal force [n] [N].
    """
    smooth = np.convolve(force_n, np.full(SMOOTHING_MS, 1.0 / SMOOTHING_MS), 'same')
    slope = np.gradient(smooth)
    inside = (t_us > t_us[0] + 1e6 * EDGE_S) & (t_us < t_us[-1] - 1e6 * EDGE_S)
    if not inside.any():
        inside[:] = True
    touching = smooth[inside & (smooth > CONTACT_N)]
    typical = float(np.median(touching)) if len(touching) else 0.0
    resting = np.flatnonzero(smooth < 1e-3)
    candidates = [
        ('no contact', int(resting[len(resting) // 8]) if len(resting) else 0),
        ('largest force', _highest(force_n, inside)),
        ('force rises', _highest(slope, inside)),
        ('force falls', _highest(-slope, inside)),
        ('typical force', _highest(-np.abs(smooth - typical) - 100.0 * np.abs(slope), inside)),
    ]
    found: list[Moment] = []
    for name, index in candidates:
        when = int(t_us[index])
        if all(abs(when - other.t_us) > 1e6 * APART_S for other in found):
            found.append(Moment(name, when))
    return sorted(found, key=lambda moment: moment.t_us)


def _highest(values: NDArray[np.float64], inside: NDArray[np.bool_]) -> int:
    return int(np.argmax(np.where(inside, values, -np.inf)))
