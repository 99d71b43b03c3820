# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Onset at once, end only after quiet."""

from __future__ import annotations

from dataclasses import dataclass

from mixtac_slip_control.errors import SlipControlError


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
