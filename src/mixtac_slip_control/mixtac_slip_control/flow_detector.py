# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Slip by the motion it makes: translation of the skin around the contact.

Events of a changing normal force point away from the contact and cancel in the translation, as does
what flickers without moving. Two sums are watched: one window for knocks, and several in a row for
slow slip, whose motion adds up while noise does not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from mixtac_slip_control.background import Background, BackgroundSettings
from mixtac_slip_control.errors import SlipControlError
from mixtac_slip_control.hysteresis import Hysteresis, HysteresisSettings

if TYPE_CHECKING:
    from mixtac_slip_control.slip_features import SlipWindow

RESOLUTION = 1e-5
"""Smallest scale of the tail of the translation [px per contrast threshold]."""


@dataclass(frozen=True, slots=True)
class FlowSettings:
    """When translation means slip; lengths in px per contrast threshold of the pixels.

    Attributes:
        background: How the translation at rest is learned.
        min_flow: Smallest threshold of the translation in one window.
        slow_windows: Windows in a row that are summed for slow slip.
        min_slow_flow: Smallest threshold of that sum.
        advance_flow_per_m: Translation that an advance of the arm makes [1/m].
        hysteresis: When a slip has ended.
    """

    background: BackgroundSettings = field(default_factory=BackgroundSettings)
    min_flow: float = 0.028
    slow_windows: int = 4
    min_slow_flow: float = 0.1
    advance_flow_per_m: float = 4e3
    hysteresis: HysteresisSettings = field(default_factory=HysteresisSettings)

    def __post_init__(self) -> None:
        """Refuse settings without a meaning.

        Raises:
            SlipControlError: A negative number or no window.
        """
        numbers = (self.min_flow, self.min_slow_flow, self.advance_flow_per_m)
        if not all(v >= 0.0 for v in numbers) or self.slow_windows < 2:
            raise SlipControlError(
                f'flow settings (min_flow, min_slow_flow, advance_flow_per_m) = {numbers}, '
                f'slow_windows = {self.slow_windows}: give numbers >= 0 and at least 2 windows'
            )


class FlowDetector:
    """Decides for each window by the translation of the skin whether the object slips.

    Without a frame there is no translation: such windows are quiet, and `learned` is false until
    enough windows with a frame have been seen.

    Args:
        settings: When translation means slip.

    Attributes:
        threshold: Of the translation in the latest window.
        flow: The translation in the latest window, or the sum's share where that is higher.
    """

    def __init__(self, settings: FlowSettings | None = None) -> None:
        self._settings = settings or FlowSettings()
        self._fast = Background(self._settings.background, RESOLUTION)
        self._slow = Background(self._settings.background, RESOLUTION)
        self._state = Hysteresis(self._settings.hysteresis)
        self._ring = np.zeros((self._settings.slow_windows, 3))
        self._at = 0
        self._present = (0.0, 0.0)
        self.threshold = 0.0
        self.flow = 0.0

    @property
    def learned(self) -> bool:
        """Whether the background is learned."""
        return self._fast.learned

    @property
    def slipping(self) -> bool:
        """Whether it slipped in the latest window."""
        return self._state.active

    def configure(self, settings: FlowSettings) -> None:
        """Take over new settings; what was learned stays."""
        if settings.slow_windows != self._settings.slow_windows:
            self._ring = np.zeros((settings.slow_windows, 3))
            self._at = 0
            self._slow.reset()
            self._fast.reset()
        self._settings = settings
        self._fast.settings = self._slow.settings = settings.background
        self._state.settings = settings.hysteresis

    def update(self, window: SlipWindow, advance_m: float = 0.0) -> bool:
        """Decide on a window.

        Args:
            window: The window.
            advance_m: How far the arm was told to move within it [m], of either sign.

        Returns:
            Whether the object slips; never before the background is learned.
        """
        self._ring[self._at] = (window.flow_x, window.flow_y, abs(advance_m))
        self._at = (self._at + 1) % len(self._ring)
        total = self._ring.sum(axis=0)
        fast = math.hypot(window.flow_x, window.flow_y)
        slow = math.hypot(float(total[0]), float(total[1]))
        self._present = (fast, slow)
        per_m = self._settings.advance_flow_per_m
        self.threshold = max(self._fast.threshold, self._settings.min_flow) + per_m * abs(advance_m)
        slow_threshold = max(self._slow.threshold, self._settings.min_slow_flow)
        slow_threshold += per_m * float(total[2])
        # On one scale: the sum as if its threshold were that of the single window.
        self.flow = max(fast, slow * self.threshold / slow_threshold)
        return self.learned and self._state.update(self.flow, 0.0, self.threshold)

    def learn(self, window: SlipWindow) -> None:
        """Take in a complete window at rest, the one of the latest update."""
        if window.guided:
            self._fast.update(self._present[0])
            self._slow.update(self._present[1])

    def reset(self) -> None:
        """Forget the background."""
        self._fast.reset()
        self._slow.reset()
        self._state.reset()
        self._ring[:] = 0.0
