# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The paper's slip criterion: more events in a window than the background explains.

Section Closed loop Slip Control: slip is detected when the 1 ms event count N_t exceeds the
background threshold N_th. A count cannot tell slip from a change of force, which moves beads too;
this is the paper's law as it stands, as the baseline. Added are a threshold by false-alarm rate,
hysteresis, and a threshold that rises with the advance in progress, which makes events as well.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from mixtac_slip_control.background import Background, BackgroundSettings
from mixtac_slip_control.errors import SlipControlError
from mixtac_slip_control.hysteresis import Hysteresis, HysteresisSettings

if TYPE_CHECKING:
    from mixtac_slip_control.slip_features import SlipWindow


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
