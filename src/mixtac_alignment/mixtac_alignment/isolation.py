# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Impulses with stillness on both sides: what a deliberate tap has and a bouncing load has not."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_alignment.impulses import Impulse

REACH_S: Final = 0.3
"""How long before and after a tap nothing may happen [s]."""
OWN_S: Final = 0.08
"""Time around an impulse that belongs to it [s]."""
SHARE: Final = 0.25
"""What counts as something happening: this part of the impulse's own height."""


def prefer_isolated(
    impulses: list[Impulse], time_s: NDArray[np.float64], signal: NDArray[np.float64]
) -> list[Impulse]:
    """Return the isolated impulses, or all where fewer than two are isolated.

    Args:
        impulses: Impulses found in a signal.
        time_s: Times of the signal [s], increasing, on the impulses' clock.
        signal: What the impulses stand out of: event rate or force, in any unit.
    """
    height = np.abs(signal - np.median(signal))
    chosen = [impulse for impulse in impulses if _is_isolated(impulse.time_s, time_s, height)]
    return chosen if len(chosen) >= 2 else impulses


def _is_isolated(at_s: float, time_s: NDArray[np.float64], height: NDArray[np.float64]) -> bool:
    far, left, right, end = np.searchsorted(
        time_s, (at_s - REACH_S, at_s - OWN_S, at_s + OWN_S, at_s + REACH_S)
    )
    own = height[left:right]
    around = np.concatenate([height[far:left], height[right:end]])
    if not len(own) or not len(around):
        return False
    return bool(around.max() < SHARE * own.max())
