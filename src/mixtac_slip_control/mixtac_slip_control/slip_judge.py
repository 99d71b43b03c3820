# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Both detectors on the same windows, and when the sensor is at rest so that they may learn."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from mixtac_slip_control.detector import CountDetector, CountSettings
from mixtac_slip_control.errors import SlipControlError
from mixtac_slip_control.flow_detector import FlowDetector, FlowSettings

if TYPE_CHECKING:
    from mixtac_slip_control.slip_features import SlipWindow

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
