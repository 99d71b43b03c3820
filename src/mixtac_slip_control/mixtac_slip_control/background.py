# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The event count while nothing moves: learned at rest, then followed slowly."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from mixtac_slip_control.errors import SlipControlError

CLIP_SIGMA: Final = 3.0
"""Counts farther out than this move the background no more than this: its tails are heavy."""


@dataclass(frozen=True, slots=True)
class BackgroundSettings:
    """How the background is learned.

    Attributes:
        learning_windows: Windows at rest from which it is first learned.
        time_constant_windows: Windows over which it follows slow changes, afterwards.
    """

    learning_windows: int = 500
    time_constant_windows: float = 5000.0

    def __post_init__(self) -> None:
        """Refuse settings without a meaning.

        Raises:
            SlipControlError: Too few windows.
        """
        if self.learning_windows < 10 or not self.time_constant_windows >= 1.0:
            raise SlipControlError(
                f'background from {self.learning_windows} windows, followed over '
                f'{self.time_constant_windows:g}: give at least 10 and 1'
            )


class Background:
    """Mean and spread of the count per window at rest.

    The spread is never below that of a Poisson process of the same mean, nor below one event, so
    that a very quiet camera does not make a threshold of nothing.

    Args:
        settings: How it is learned.
    """

    def __init__(self, settings: BackgroundSettings | None = None) -> None:
        self.settings = settings or BackgroundSettings()
        self._first: list[int] = []
        self._mean = 0.0
        self._variance = 0.0
        self._learned = False

    @property
    def learned(self) -> bool:
        """Whether enough windows have been seen."""
        return self._learned

    @property
    def mean(self) -> float:
        """Expected events per window; 0 until learned."""
        return self._mean

    @property
    def sigma(self) -> float:
        """Spread of the events per window, at least 1."""
        return max(math.sqrt(self._variance), math.sqrt(self._mean), 1.0)

    def update(self, count: int) -> None:
        """Take in the count of a window at rest.

        Args:
            count: Events in the window.
        """
        if not self._learned:
            self._learn(count)
            return
        gain = 1.0 / self.settings.time_constant_windows
        reach = CLIP_SIGMA * self.sigma
        step = min(max(count - self._mean, -reach), reach)
        self._mean = max(0.0, self._mean + gain * step)
        self._variance += gain * (step**2 - self._variance)

    def reset(self) -> None:
        """Forget the background, to learn it anew."""
        self._first.clear()
        self._mean = self._variance = 0.0
        self._learned = False

    def _learn(self, count: int) -> None:
        """Collect the first windows; median and quartiles keep single knocks out."""
        self._first.append(count)
        if len(self._first) < self.settings.learning_windows:
            return
        low, self._mean, high = (float(q) for q in np.quantile(self._first, (0.25, 0.5, 0.75)))
        self._variance = ((high - low) / 1.349) ** 2
        self._first.clear()
        self._learned = True
