# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Background, detector and advance law as one step per counting window."""

from __future__ import annotations

from dataclasses import dataclass, field

from mixtac_slip_control.advance_law import AdvanceLaw, AdvanceSettings
from mixtac_slip_control.background import Background, BackgroundSettings
from mixtac_slip_control.detector import DetectorSettings, SlipDetector
from mixtac_slip_control.errors import SlipControlError


@dataclass(frozen=True, slots=True)
class SlipSettings:
    """Settings of the three parts.

    Attributes:
        background: How the background is learned.
        detector: When a count means slip.
        advance: Gain and limits of the advance.
        settle_windows: Windows without slip after which the sensor is at rest again and the
            background follows.
    """

    background: BackgroundSettings = field(default_factory=BackgroundSettings)
    detector: DetectorSettings = field(default_factory=DetectorSettings)
    advance: AdvanceSettings = field(default_factory=AdvanceSettings)
    settle_windows: int = 100


@dataclass(frozen=True, slots=True)
class SlipStep:
    """What one window led to; the fields are those of `mixtac_msgs/SlipState`.

    Attributes:
        count: Events in the window.
        background: Expected count at rest.
        background_sigma: Its spread.
        threshold: Count above which the object slips.
        slipping: Whether it does; never before the background is learned.
        enabled: Whether advances are asked for.
        advance: Asked for by this window, along the contact normal [m].
        total_advance: Since enabling [m].
    """

    count: int
    background: float
    background_sigma: float
    threshold: float
    slipping: bool
    enabled: bool
    advance: float
    total_advance: float


class SlipController:
    """Watches the event count and, when enabled, asks for advances against slip.

    Without new windows it asks for nothing: when events stop, the arm stays where it is.

    Args:
        settings: Settings of its parts.
    """

    def __init__(self, settings: SlipSettings | None = None) -> None:
        self._settings = settings or SlipSettings()
        self._background = Background(self._settings.background)
        self._detector = SlipDetector(self._settings.detector)
        self._law = AdvanceLaw(self._settings.advance)
        self._enabled = False
        self._rest = self._settings.settle_windows

    @property
    def enabled(self) -> bool:
        """Whether advances are asked for."""
        return self._enabled

    @property
    def calibrated(self) -> bool:
        """Whether the background is learned."""
        return self._background.learned

    def configure(self, settings: SlipSettings) -> None:
        """Take over new settings; the background and the sum of advances stay."""
        self._settings = settings
        self._background.settings = settings.background
        self._detector.settings = settings.detector
        self._law.settings = settings.advance

    def enable(self) -> None:
        """Start asking for advances, from a sum of zero.

        Raises:
            SlipControlError: The background is not learned, or the count says slip already.
        """
        if not self.calibrated:
            raise SlipControlError(
                'the event background is not learned yet: keep the contact still for '
                f'{self._settings.background.learning_windows} windows, with events arriving'
            )
        if self._detector.slipping:
            raise SlipControlError(
                'the event count is above the slip threshold: wait until the contact is still, or '
                'learn the background anew'
            )
        self._law.reset()
        self._enabled = True

    def disable(self) -> None:
        """Stop asking for advances; the sum stays on record until the next enabling."""
        self._enabled = False

    def recalibrate(self) -> None:
        """Learn the background anew, from the next windows.

        Raises:
            SlipControlError: Slip control is enabled.
        """
        if self._enabled:
            raise SlipControlError('slip control is enabled: disable it before calibrating')
        self._background.reset()
        self._detector.reset()
        self._rest = self._settings.settle_windows

    def step(self, count: int, *, complete: bool = True) -> SlipStep:
        """Process the next window.

        Args:
            count: Events in the window.
            complete: False where packets of the window were lost: such a count may show slip, but
                says nothing of the background.
        """
        mean, sigma = self._background.mean, self._background.sigma
        threshold = self._detector.threshold(mean, sigma)
        slipping = self.calibrated and self._detector.update(count, mean, sigma)
        advance = self._law.update(count, threshold, slipping=slipping) if self._enabled else 0.0
        self._rest = 0 if slipping else self._rest + 1
        if complete and self._rest >= self._settings.settle_windows:
            self._background.update(count)
        return SlipStep(
            count=count,
            background=mean,
            background_sigma=sigma,
            threshold=threshold,
            slipping=slipping,
            enabled=self._enabled,
            advance=advance,
            total_advance=self._law.total,
        )
