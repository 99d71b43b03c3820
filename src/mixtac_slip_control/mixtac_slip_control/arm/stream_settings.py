# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""How advances are turned into streamed trajectories."""

from __future__ import annotations

import math
from dataclasses import dataclass

from mixtac_slip_control.arm.errors import ArmError


@dataclass(frozen=True, slots=True)
class StreamSettings:
    """Settings of the advance planner.

    Attributes:
        lead_s: From the call to the first point that may differ from what was sent before [s]. It
            must cover the worst transport to the controller and two of its cycles, one until it
            looks and one by which it commands ahead.
        overlap_s: How far before the call a trajectory begins [s]: at least two cycles, so that
            the controller never joins its own last command to our first point.
        interval_s: Least time between two trajectories [s].
        spacing_s: Time between points [s].
        share: Of the joints' rate limits that may be used; the rest is reserve.
        max_speed: Largest speed of the tip [m/s].
        max_advance: Largest advance since the reset [m].
        min_change: Changes of the target below this are waited with [m].
        history_s: How long past advances are remembered [s].
    """

    lead_s: float = 6e-3
    overlap_s: float = 3e-3
    interval_s: float = 2e-3
    spacing_s: float = 1e-3
    share: float = 0.95
    max_speed: float = 0.25
    max_advance: float = 0.02
    min_change: float = 1e-7
    history_s: float = 0.25

    def __post_init__(self) -> None:
        """Refuse settings that no trajectory can follow.

        Raises:
            ArmError: A value that is not finite, not positive or out of its range.
        """
        for name in self.__slots__:
            value = getattr(self, name)
            if not math.isfinite(value) or value < 0.0:
                raise ArmError(f'{name} = {value}: give a finite number, zero or more')
        if not 2e-4 <= self.spacing_s <= 1e-2:
            raise ArmError(f'spacing_s = {self.spacing_s}: give 0.0002 to 0.01 s')
        if not 0.0 < self.share <= 1.0:
            raise ArmError(f'share = {self.share}: give more than 0, at most 1')
        if self.max_speed == 0.0 or not 0.0 < self.max_advance <= 0.1:
            raise ArmError(
                f'max_speed = {self.max_speed} m/s, max_advance = {self.max_advance} m: give a '
                'speed above 0 and an advance above 0, at most 0.1 m'
            )
