# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Slip detectors: the event count of the paper and the translation of the skin, with hysteresis.

Count (paper, section Closed loop Slip Control): slip is detected when the event count N_t of a 1 ms
window exceeds the background threshold N_th. A count cannot tell slip from a change of force, which
moves beads too. It is the paper's law as it stands, as the baseline; added are a threshold by
false-alarm rate, hysteresis, and a threshold that rises with the advance in progress, which makes
events as well.

Flow: translation of the skin around the contact. Events of a changing normal force point away from
the contact and cancel in the translation, and so do pixels that flicker without motion. One window
is watched for knocks, and a sum over several for slow slip, whose motion adds up while noise does
not.

`SlipJudge` runs both on the same windows and lets them learn their background while the contact is
at rest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

import numpy as np

from mixtac_slip_control.background import Background, BackgroundSettings
from mixtac_slip_control.errors import SlipControlError

if TYPE_CHECKING:
    from mixtac_slip_control.features import SlipWindow


@dataclass(frozen=True, slots=True)
class HysteresisSettings:
    """When a slip has ended.

    Attributes:
        release_ratio: Part of the way from the background to the threshold below which a window
            is quiet, 0 to 1.
        release_windows: Quiet windows in a row that end a slip.
    """

    release_ratio: float = 0.5
    release_windows: int = 5

    def __post_init__(self) -> None:
        """Refuse settings without a meaning.

        Raises:
            SlipControlError: A ratio outside 0 to 1, or no window.
        """
        if not 0.0 <= self.release_ratio <= 1.0 or self.release_windows < 1:
            raise SlipControlError(
                f'release at {self.release_ratio:g} of the threshold for {self.release_windows} '
                'windows: give a ratio of 0 to 1 and at least one window'
            )


class Hysteresis:
    """Turns a value and its threshold into slipping or not.

    Attributes:
        active: Whether it slipped in the latest window.
    """

    def __init__(self, settings: HysteresisSettings | None = None) -> None:
        self.settings = settings or HysteresisSettings()
        self.active = False
        self._quiet = 0

    def update(self, value: float, background: float, threshold: float) -> bool:
        """Decide on a window and return whether it slips."""
        release = background + self.settings.release_ratio * (threshold - background)
        if value > threshold:
            self.active = True
            self._quiet = 0
        elif self.active:
            self._quiet = self._quiet + 1 if value <= release else 0
            self.active = self._quiet < self.settings.release_windows
        return self.active

    def reset(self) -> None:
        """Return to rest."""
        self.active = False
        self._quiet = 0


@dataclass(frozen=True, slots=True)
class CountSettings:
    """When a count means slip.

    Attributes:
        background: How the count at rest is learned.
        min_excess: Smallest threshold above the background [events per window].
        advance_events_per_m: Events that an advance of the arm makes [1/m].
        hysteresis: When a slip has ended.
    """

    background: BackgroundSettings = field(default_factory=BackgroundSettings)
    min_excess: float = 20.0
    advance_events_per_m: float = 2.5e7
    hysteresis: HysteresisSettings = field(default_factory=HysteresisSettings)

    def __post_init__(self) -> None:
        """Refuse settings without a meaning.

        Raises:
            SlipControlError: A negative number.
        """
        if not (self.min_excess >= 0.0 and self.advance_events_per_m >= 0.0):
            raise SlipControlError(
                f'threshold at least {self.min_excess:g} events above the background, '
                f'{self.advance_events_per_m:g} events per metre of advance: give numbers >= 0'
            )


class CountDetector:
    """Decides for each window by its count whether the object slips.

    Args:
        settings: When a count means slip.

    Attributes:
        background: The counts at rest.
        threshold: N_th in the latest window: what no count at rest exceeds.
        expected: What counts at rest seldom exceed, and the events of the advance: what is above
            comes from slip once slip is known by other means.
    """

    def __init__(self, settings: CountSettings | None = None) -> None:
        self._settings = settings or CountSettings()
        self.background = Background(self._settings.background)
        self._state = Hysteresis(self._settings.hysteresis)
        self.threshold = self.expected = 0.0

    @property
    def learned(self) -> bool:
        """Whether the background is learned."""
        return self.background.learned

    @property
    def slipping(self) -> bool:
        """Whether it slipped in the latest window."""
        return self._state.active

    def configure(self, settings: CountSettings) -> None:
        """Take over new settings; what was learned stays."""
        self._settings = settings
        self.background.settings = settings.background
        self._state.settings = settings.hysteresis

    def update(self, window: SlipWindow, advance_m: float = 0.0) -> bool:
        """Decide on a window.

        Args:
            window: The window.
            advance_m: How far the arm was told to move within it [m], of either sign.

        Returns:
            Whether the object slips; never before the background is learned.
        """
        middle = self.background.median
        still = max(self.background.threshold, middle + self._settings.min_excess)
        own = self._settings.advance_events_per_m * abs(advance_m)
        self.threshold, self.expected = still + own, self.background.begin + own
        return self.learned and self._state.update(window.count, middle, self.threshold)

    def learn(self, window: SlipWindow) -> None:
        """Take in a complete window at rest."""
        self.background.update(float(window.count))

    def reset(self) -> None:
        """Forget the background."""
        self.background.reset()
        self._state.reset()


FLOW_RESOLUTION = 1e-5
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
        self._fast = Background(self._settings.background, FLOW_RESOLUTION)
        self._slow = Background(self._settings.background, FLOW_RESOLUTION)
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


DETECTORS: Final = ('flow', 'count')
"""Names of the detectors; the first is the default."""


@dataclass(frozen=True, slots=True)
class JudgeSettings:
    """Settings of both detectors.

    Attributes:
        detector: Whose word counts: one of `DETECTORS`.
        count: Of the paper's law.
        flow: Of the flow detector.
        settle_windows: Windows without slip and advance after which the background follows.
    """

    detector: str = 'flow'
    count: CountSettings = field(default_factory=CountSettings)
    flow: FlowSettings = field(default_factory=FlowSettings)
    settle_windows: int = 100

    def __post_init__(self) -> None:
        """Refuse an unknown detector.

        Raises:
            SlipControlError: As above.
        """
        if self.detector not in DETECTORS or self.settle_windows < 0:
            raise SlipControlError(
                f'detector {self.detector!r}, settling for {self.settle_windows} windows: choose '
                f'one of {", ".join(DETECTORS)} and at least 0 windows'
            )


class SlipJudge:
    """Runs both detectors and lets them learn at rest.

    Args:
        settings: Of both.

    Attributes:
        count: The paper's law.
        flow: The flow detector.
        slipping: What the chosen one says of the latest window.
    """

    def __init__(self, settings: JudgeSettings | None = None) -> None:
        self._settings = settings or JudgeSettings()
        self.count = CountDetector(self._settings.count)
        self.flow = FlowDetector(self._settings.flow)
        self.slipping = False
        self._rest = self._settings.settle_windows

    @property
    def learned(self) -> bool:
        """Whether the background that the chosen detector and the law need is known."""
        return self.count.learned and (self._settings.detector == 'count' or self.flow.learned)

    @property
    def law_threshold(self) -> float:
        """N_th of the advance law: with the flow detector, counts need not tell slip as well."""
        by_flow = self._settings.detector == 'flow'
        return self.count.expected if by_flow else self.count.threshold

    def configure(self, settings: JudgeSettings) -> None:
        """Take over new settings; what was learned stays."""
        self._settings = settings
        self.count.configure(settings.count)
        self.flow.configure(settings.flow)

    def update(self, window: SlipWindow, advance_m: float) -> bool:
        """Decide on a window, and learn from it if the sensor is at rest.

        Args:
            window: The next window.
            advance_m: How far the arm was told to move within it [m].

        Returns:
            Whether the object slips, by the chosen detector.
        """
        by_count = self.count.update(window, advance_m)
        by_flow = self.flow.update(window, advance_m)
        self.slipping = by_flow if self._settings.detector == 'flow' else by_count
        moving = by_count or by_flow or advance_m != 0.0
        self._rest = 0 if moving else self._rest + 1
        if window.complete and self._rest >= self._settings.settle_windows:
            self.count.learn(window)
            self.flow.learn(window)
        return self.slipping

    def reset(self) -> None:
        """Forget what was learned."""
        self.count.reset()
        self.flow.reset()
        self.slipping = False
        self._rest = self._settings.settle_windows
