# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The paper's slip criterion: more events in a window than the background explains.

Section Closed loop Slip Control: slip is detected when the 1 ms event count N_t exceeds the
background threshold N_th. A count cannot tell slip from a change of force, which moves beads too;
this is the paper's law as it stands, with hysteresis added so that it does not chatter.
"""

from __future__ import annotations

from dataclasses import dataclass

from mixtac_slip_control.errors import SlipControlError


@dataclass(frozen=True, slots=True)
class DetectorSettings:
    """When a count means slip.

    Attributes:
        n_sigma: Threshold above the background, in its spreads.
        min_excess: Smallest threshold above the background [events per window].
        release_ratio: Part of that distance below which a count is quiet again, 0 to 1.
        release_windows: Quiet windows in a row that end a slip.
    """

    n_sigma: float = 6.0
    min_excess: float = 20.0
    release_ratio: float = 0.5
    release_windows: int = 5

    def __post_init__(self) -> None:
        """Refuse settings without a meaning.

        Raises:
            SlipControlError: A threshold below the background, or a ratio outside 0 to 1.
        """
        if not (self.n_sigma >= 0.0 and self.min_excess >= 0.0):
            raise SlipControlError(
                f'threshold of {self.n_sigma:g} sigma and {self.min_excess:g} events over the '
                'background: give numbers >= 0'
            )
        if not 0.0 <= self.release_ratio <= 1.0 or self.release_windows < 1:
            raise SlipControlError(
                f'release at {self.release_ratio:g} of the threshold for {self.release_windows} '
                'windows: give a ratio of 0 to 1 and at least one window'
            )


class SlipDetector:
    """Decides for each window whether the object slips.

    Attributes:
        slipping: Whether it slipped in the latest window.

    Args:
        settings: When a count means slip.
    """

    def __init__(self, settings: DetectorSettings | None = None) -> None:
        self.settings = settings or DetectorSettings()
        self.slipping = False
        self._quiet = 0

    def threshold(self, background: float, sigma: float) -> float:
        """Return N_th [events per window] over a background."""
        return background + max(self.settings.n_sigma * sigma, self.settings.min_excess)

    def update(self, count: int, background: float, sigma: float) -> bool:
        """Decide on a window.

        Args:
            count: Events in the window, N_t.
            background: Expected count at rest.
            sigma: Its spread.

        Returns:
            Whether the object slips.
        """
        threshold = self.threshold(background, sigma)
        release = background + self.settings.release_ratio * (threshold - background)
        if count > threshold:
            self.slipping = True
            self._quiet = 0
        elif self.slipping:
            self._quiet = self._quiet + 1 if count <= release else 0
            self.slipping = self._quiet < self.settings.release_windows
        return self.slipping

    def reset(self) -> None:
        """Return to rest."""
        self.slipping = False
        self._quiet = 0
