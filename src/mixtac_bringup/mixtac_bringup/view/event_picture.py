# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A picture of the events of a short time, by polarity."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_events.arrays import Events

Colour = tuple[int, int, int]
BACKGROUND = (24, 26, 30)
BRIGHTER = (86, 180, 233)
"""Of Okabe and Ito's palette, which colour-blind people tell apart, as `DARKER`."""
DARKER = (230, 120, 20)
FULL = 3
"""Events of one polarity, more than of the other, at which a pixel has its full colour."""
STILL = FULL + 1
"""Level of a pixel without events, or with as many of both polarities. 0 is no level."""


class EventPicture:
    """Adds up events per pixel, brighter minus darker, until the picture is taken.

    Args:
        width: Columns of the sensor.
        height: Rows of the sensor.

    Attributes:
        shape: Rows and columns.
    """

    def __init__(self, width: int, height: int) -> None:
        self.shape = (height, width)
        self._sum = np.zeros(height * width, np.int64)

    def add(self, events: Events) -> None:
        """Count events; their coordinates lie inside, as the decoder has checked."""
        height, width = self.shape
        places = events.y.astype(np.intp) * width + events.x
        counts = np.bincount(places, weights=2.0 * events.polarity - 1.0, minlength=height * width)
        self._sum += counts.astype(np.int64)

    def take(self) -> NDArray[np.uint8]:
        """Return the picture, one level per pixel [height, width], and start the next one."""
        levels = (np.clip(self._sum, -FULL, FULL) + STILL).astype(np.uint8)
        self._sum[:] = 0
        return levels.reshape(self.shape)


def palette() -> dict[int, Colour]:
    """Return the colour of each level."""
    colours = {STILL: BACKGROUND}
    for step in range(1, FULL + 1):
        shade = 0.35 + 0.65 * (step - 1) / (FULL - 1)
        colours[STILL + step] = _mixed(BRIGHTER, shade)
        colours[STILL - step] = _mixed(DARKER, shade)
    return colours


def _mixed(colour: Colour, shade: float) -> Colour:
    red, green, blue = (
        round(shade * full + (1.0 - shade) * none)
        for full, none in zip(colour, BACKGROUND, strict=True)
    )
    return red, green, blue
