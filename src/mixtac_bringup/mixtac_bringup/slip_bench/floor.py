# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What no controller can beat: the same grasp, the same knock, and the best motion of the arm."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mixtac_sim.contact_steps import STEP_US

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_sim.grasp.grasp import Grasp

GRID_S = 1e-6 * STEP_US
AFTER_S = 0.3
"""How long is waited for the object to stop [s]."""


@dataclass(frozen=True, slots=True)
class ArmReach:
    """What the arm can do along the contact normal.

    Attributes:
        acceleration: [m/s2].
        jerk: [m/s3].
        lag_s: Time constant of its tracking [s].
        max_force_n: Force at which the advance must end [N].
    """

    acceleration: float
    jerk: float
    lag_s: float
    max_force_n: float


@dataclass(frozen=True, slots=True)
class Arrest:
    """How an object came to rest.

    Attributes:
        slip_mm: How far it moved from the blow on [mm].
        arrest_ms: Until it stood still [ms]; NaN if it did not.
    """

    slip_mm: float
    arrest_ms: float

    @property
    def held(self) -> bool:
        """Whether it stood still in the end, no more than 5 mm lower."""
        return bool(np.isfinite(self.arrest_ms)) and self.slip_mm <= HELD_MM


HELD_MM = 5.0
"""Farther down an object counts as lost [mm]: the fingertip's contact is 12 mm wide."""
STILL_S = 0.02
"""How long it must stand still [s]."""


def arrest_of(
    t_us: NDArray[np.int64],
    object_mm: NDArray[np.float64],
    speed_mm_s: NDArray[np.float64],
    onset_us: float,
) -> Arrest:
    """Return how an object came to rest after a blow.

    Args:
        t_us: Times [n] [us].
        object_mm: Its place [n] [mm].
        speed_mm_s: Its speed [n] [mm/s].
        onset_us: When the blow began [us].
    """
    first = int(np.searchsorted(t_us, onset_us))
    slip = float(object_mm[-1] - object_mm[max(first - 1, 0)])
    moving = np.flatnonzero(speed_mm_s != 0.0)
    last = int(moving[-1]) if len(moving) else first
    stopped = t_us[-1] - t_us[last] >= 1e6 * STILL_S
    return Arrest(slip, 1e-3 * float(t_us[last] - onset_us) if stopped else float('nan'))


def best_arrest(grasp: Grasp, reach: ArmReach, delay_s: float) -> Arrest:
    """Return the arrest by the fastest motion to the force limit, begun after a delay.

    Args:
        grasp: A fresh one without a camera.
        reach: The arm.
        delay_s: From the onset of the blow to the begin of the commanded motion [s].
    """
    knock = round(grasp.setup.knock_s / GRID_S)
    count = knock + round(AFTER_S / GRID_S)
    distance = (reach.max_force_n - grasp.grasp_n) / grasp.stiffness_n_per_mm
    way = np.zeros(count)
    begin = knock + round(delay_s / GRID_S)
    way[begin:] = fastest_way(max(distance, 0.0), reach, count - begin)
    block = grasp.advance(way)
    return arrest_of(block.t_us, block.object_mm, block.speed_mm_s, 1e6 * grasp.setup.knock_s)


def fastest_way(distance_mm: float, reach: ArmReach, count: int) -> NDArray[np.float64]:
    """Return the fastest rest-to-rest motion within acceleration and jerk, lagged [count] [mm].

    Full acceleration, then full braking, each with ramps of the jerk's time: that is the
    convolution of a bang-bang motion with a window of that time. Sampled every 125 us.
    """
    t = (np.arange(count) + 1) * GRID_S
    half_s = np.sqrt(1e-3 * distance_mm / reach.acceleration)
    rising = 0.5e3 * reach.acceleration * t**2
    falling = distance_mm - 0.5e3 * reach.acceleration * np.maximum(2.0 * half_s - t, 0.0) ** 2
    way = np.where(t < half_s, rising, falling)
    width = max(round(reach.acceleration / reach.jerk / GRID_S), 1)
    smooth = np.convolve(np.append(np.zeros(width - 1), way), np.full(width, 1.0 / width), 'valid')
    if reach.lag_s <= 0.0:
        return np.asarray(smooth)
    keep, place = np.exp(-GRID_S / reach.lag_s), 0.0
    for k, wanted in enumerate(smooth):
        place = wanted + keep * (place - wanted)
        smooth[k] = place
    return np.asarray(smooth)
