# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
r"""The paper's control law: advance along the contact normal in proportion to the excess count.

Section Closed loop Slip Control: :math:`\Delta d_t = k\,(N_t - N_{th})`. Added here: a limit per
window, a limit of the sum, and an optional slow return after a hold. The sum is what guards the
object and the gel: at a contact stiffness of k_n the force cannot grow by more than k_n times it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from mixtac_slip_control.errors import SlipControlError


@dataclass(frozen=True, slots=True)
class AdvanceSettings:
    """Gain and limits of the advance.

    Attributes:
        gain: k, advance per event above the threshold [m].
        max_step: Largest advance in one window [m].
        max_total: Largest sum of advances since enabling [m].
        hold_windows: Windows without slip for which the sum is held before it may shrink.
        back_off_step: Return per window after the hold [m]; 0 holds for ever, as the paper does.
    """

    gain: float = 3e-8
    max_step: float = 5e-5
    max_total: float = 1e-3
    hold_windows: int = 200
    back_off_step: float = 0.0

    def __post_init__(self) -> None:
        """Refuse settings without a meaning.

        Raises:
            SlipControlError: A gain or limit that is negative or no number.
        """
        lengths = (self.gain, self.max_step, self.max_total, self.back_off_step)
        if not all(math.isfinite(v) and v >= 0.0 for v in lengths) or self.hold_windows < 0:
            raise SlipControlError(
                f'advance settings (gain, max_step, max_total, back_off_step) = {lengths} m, '
                f'hold_windows = {self.hold_windows}: give finite numbers >= 0'
            )


class AdvanceLaw:
    """Turns counts into advances, within limits that hold for every input.

    Attributes:
        total: Sum of the advances since the last reset [m], always 0 to `max_total`.

    Args:
        settings: Gain and limits.
    """

    def __init__(self, settings: AdvanceSettings | None = None) -> None:
        self.settings = settings or AdvanceSettings()
        self.total = 0.0
        self._held = 0

    def update(self, count: int, threshold: float, *, slipping: bool) -> float:
        """Return the advance of a window [m]; negative only while backing off.

        Args:
            count: Events in the window, N_t.
            threshold: N_th.
            slipping: Whether the object slips.
        """
        wanted = self._wanted(count, threshold, slipping=slipping)
        before = self.total
        self.total = min(max(before + wanted, 0.0), max(before, self.settings.max_total))
        return self.total - before

    def reset(self) -> None:
        """Start over at the present position."""
        self.total = 0.0
        self._held = 0

    def _wanted(self, count: int, threshold: float, *, slipping: bool) -> float:
        if slipping:
            self._held = 0
            return min(max(self.settings.gain * (count - threshold), 0.0), self.settings.max_step)
        self._held += 1
        return -self.settings.back_off_step if self._held > self.settings.hold_windows else 0.0
