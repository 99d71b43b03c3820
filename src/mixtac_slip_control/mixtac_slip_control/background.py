# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The distribution of a quantity while nothing slips, and the value it exceeds at a stated rate.

Event counts at rest have tails much heavier than a Poisson process (frame read-out, hot pixels,
ripple), so neither a Poisson nor a normal distribution gives a threshold. The tail itself is
measured: excesses over a high quantile follow a generalised Pareto distribution (Pickands 1975,
Balkema and de Haan 1974). Its scale comes from their mean, its shape is a stated assumption.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from mixtac_slip_control.errors import SlipControlError

TAIL: Final = 0.1
"""Part of the windows at rest that form the tail."""
CLIP_SCALES: Final = 12.0
"""An excess of more scales counts as this many: one knock must not blunt the sensor."""


@dataclass(frozen=True, slots=True)
class BackgroundSettings:
    """How the background is learned and how far out the threshold lies.

    Attributes:
        learning_windows: Windows at rest from which it is first learned.
        time_constant_windows: Windows over which it follows slow changes, afterwards.
        alarm_probability: Part of the windows at rest that may exceed the threshold.
        tail_shape: Shape of the generalised Pareto law; 0 is an exponential tail.
    """

    learning_windows: int = 1000
    time_constant_windows: float = 20000.0
    alarm_probability: float = 1e-7
    tail_shape: float = 0.1

    def __post_init__(self) -> None:
        """Refuse settings without a meaning.

        Raises:
            SlipControlError: Too few windows, or a probability outside the tail.
        """
        if self.learning_windows < 50 or not self.time_constant_windows >= 100.0:
            raise SlipControlError(
                f'background from {self.learning_windows} windows, followed over '
                f'{self.time_constant_windows:g}: give at least 50 and 100'
            )
        if not 0.0 < self.alarm_probability < TAIL or not 0.0 <= self.tail_shape < 1.0:
            raise SlipControlError(
                f'alarm probability {self.alarm_probability:g} per window with tail shape '
                f'{self.tail_shape:g}: give one below {TAIL:g} and a shape from 0 to below 1'
            )

    @property
    def reach(self) -> float:
        """Distance of the threshold from the tail's begin, in scales of the tail."""
        ratio = TAIL / self.alarm_probability
        if self.tail_shape == 0.0:
            return math.log(ratio)
        return float((ratio**self.tail_shape - 1.0) / self.tail_shape)


class Background:
    """Median, begin and scale of the tail of a quantity at rest.

    Args:
        settings: How it is learned.
        resolution: Smallest scale of the tail: 1 for counts.
    """

    def __init__(self, settings: BackgroundSettings | None = None, resolution: float = 1.0) -> None:
        self.settings = settings or BackgroundSettings()
        self._resolution = resolution
        self._first: list[float] = []
        self._median = self._begin = 0.0
        self._scale = resolution
        self._learned = False

    @property
    def learned(self) -> bool:
        """Whether enough windows have been seen."""
        return self._learned

    @property
    def median(self) -> float:
        """Middle of the quantity at rest; 0 until learned."""
        return self._median

    @property
    def scale(self) -> float:
        """Scale of its tail."""
        return self._scale

    @property
    def begin(self) -> float:
        """Where its tail begins: the quantile of 1 - `TAIL`."""
        return self._begin

    @property
    def threshold(self) -> float:
        """What a window at rest exceeds with the stated probability."""
        return self._begin + self.settings.reach * self._scale

    def update(self, value: float) -> None:
        """Take in a window at rest."""
        if not self._learned:
            self._learn(value)
            return
        # Stochastic approximation of the two quantiles: steps of a size set by the tail's scale.
        gain = 1.0 / self.settings.time_constant_windows
        step = gain * 10.0 * self._scale
        self._median += step * (0.5 if value > self._median else -0.5)
        above = value > self._begin
        self._begin += step * ((1.0 - TAIL) if above else -TAIL)
        if above:
            excess = min(value - self._begin, CLIP_SCALES * self._scale)
            self._scale += gain / TAIL * (excess * (1.0 - self.settings.tail_shape) - self._scale)
            self._scale = max(self._scale, self._resolution)

    def reset(self) -> None:
        """Forget the background, to learn it anew."""
        self._first.clear()
        self._median = self._begin = 0.0
        self._scale = self._resolution
        self._learned = False

    def _learn(self, value: float) -> None:
        self._first.append(value)
        if len(self._first) < self.settings.learning_windows:
            return
        values = np.array(self._first)
        self._median, self._begin = (float(q) for q in np.quantile(values, (0.5, 1.0 - TAIL)))
        excess = values[values > self._begin] - self._begin
        # The mean of a generalised Pareto law is scale / (1 - shape).
        mean = float(excess.mean()) if len(excess) else 0.0
        self._scale = max(mean * (1.0 - self.settings.tail_shape), self._resolution)
        self._first.clear()
        self._learned = True
