# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Setting the exposure by the brightness of the frames.

A pixel's signal grows in proportion to the exposure until it saturates. So each frame says by
itself which exposure would have been right: its own, which it carries, times target over mean. That
does not depend on what was asked for since, and frames that were under way when the exposure was
changed say the same as those before: the delay of two frames or so from a request to the first
frame that shows it cannot make the loop swing.

A saturated pixel hides how bright it is, and a black one is noise. Frames full of either only say
in which direction to go: steps are bounded by `LARGEST_STEP`, and the frames that follow say more.
Estimates are averaged over frames in the logarithm, and changes too small to see are not made, so
that the brightness does not flicker.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

FULL_SCALE = 1023
LARGEST_STEP = 4.0
DEAD_BAND = 0.08
"""Relative change below which the exposure stays."""
SMOOTHING = 0.5
"""Weight of the latest frame."""


@dataclass(frozen=True, slots=True)
class ExposureLimits:
    """What the controller aims at and where it stops.

    Attributes:
        target: Mean brightness, 0 .. 1 of full scale.
        minimum_us: Shortest exposure [us].
        maximum_us: Longest exposure [us].
    """

    target: float
    minimum_us: int
    maximum_us: int


def right_exposure(image: NDArray[np.uint16], exposure_us: float, target: float) -> float:
    """Return the exposure that would have brought a frame to the target [us].

    Args:
        image: `uint16`, any shape, 0 .. 1023.
        exposure_us: Exposure of the frame [us].
        target: Wanted mean, 0 .. 1 of full scale.
    """
    factor = target * FULL_SCALE / max(float(image.mean()), 1e-3)
    return exposure_us * min(max(factor, 1 / LARGEST_STEP), LARGEST_STEP)


class AutoExposure:
    """Follows the frames of one camera.

    Args:
        exposure_us: Exposure to begin with [us].
        limits: Target and limits.

    Attributes:
        exposure_us: Exposure that was asked for last [us].
    """

    def __init__(self, exposure_us: int, limits: ExposureLimits) -> None:
        self.limits = limits
        self.exposure_us = self._limited(exposure_us)
        self._wish = math.log(self.exposure_us)

    def update(self, image: NDArray[np.uint16], exposure_us: float) -> int | None:
        """Take a frame; return the exposure to ask for [us], or None where it may stay.

        Ask again with the next frame if the camera could not be told: until `accept` is called
        the exposure counts as unchanged.

        Args:
            image: `uint16`, 0 .. 1023.
            exposure_us: Exposure of the frame [us].
        """
        right = self._limited(right_exposure(image, exposure_us, self.limits.target))
        self._wish += SMOOTHING * (math.log(right) - self._wish)
        wish = self._limited(math.exp(self._wish))
        at_limit = wish in {self.limits.minimum_us, self.limits.maximum_us}
        change = abs(math.log(wish / self.exposure_us))
        if change == 0 or (change < DEAD_BAND and not at_limit):
            return None
        return wish

    def accept(self, exposure_us: int) -> None:
        """Take note that the camera was told this exposure [us]."""
        self.exposure_us = exposure_us

    def _limited(self, exposure_us: float) -> int:
        return round(min(max(exposure_us, self.limits.minimum_us), self.limits.maximum_us))
