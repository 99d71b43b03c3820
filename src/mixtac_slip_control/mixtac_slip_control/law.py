# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
r"""The advance law: how far the arm shall advance along the contact normal.

Section Closed loop Slip Control of the paper: :math:`\Delta d_t = k\,(N_t - N_{th})`. Here k is
G / C, where C is events per metre of skin motion, so that G is a plain number: advance over motion
of the skin. Added are a memory, because an object that slides over a skin dragged as far as it goes
makes no more events (an excess is answered for some windows on while the slip lasts), and what
protects arm, gel and object: a limit per window, a limit of the sum, a hold after each slip, and
between slips a slow servo on the force, which takes back the advance that is no longer needed and
makes up for relaxation of the gel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from mixtac_slip_control.errors import SlipControlError


@dataclass(frozen=True, slots=True)
class AdvanceSettings:
    """Gain and limits of the advance.

    Attributes:
        gain: G, advance over motion of the skin.
        events_per_m: C, events per metre that the skin moves [1/m].
        memory_windows: Windows in which the answer to an excess of events fades to 1/e while the
            slip lasts; 0 answers each window by itself, as the paper does.
        max_step: Largest advance in one window [m].
        max_total: Largest sum of advances since enabling [m].
        hold_windows: Windows without slip for which the sum is held.
        back_off_step: Largest return per window after the hold [m]; 0 holds for ever.
        preload_step: Largest advance per window to keep the preload [m]; 0 does not keep it.
        force_band: Force from the wanted one within which nothing is done [N].
    """

    gain: float = 0.7
    events_per_m: float = 1e7
    memory_windows: float = 0.0
    max_step: float = 5e-5
    max_total: float = 1e-3
    hold_windows: int = 300
    back_off_step: float = 2e-8
    preload_step: float = 1e-7
    force_band: float = 0.03

    def __post_init__(self) -> None:
        """Refuse settings without a meaning.

        Raises:
            SlipControlError: A gain or limit that is negative or no number, or no events.
        """
        numbers = (
            self.gain,
            self.memory_windows,
            self.max_step,
            self.max_total,
            self.back_off_step,
            self.preload_step,
            self.force_band,
        )
        if not all(math.isfinite(v) and v >= 0.0 for v in numbers) or self.hold_windows < 0:
            raise SlipControlError(
                'advance settings (gain, memory_windows, max_step, max_total, back_off_step, '
                f'preload_step, force_band) = {numbers}, hold_windows = {self.hold_windows}: '
                'give finite numbers >= 0'
            )
        if not (math.isfinite(self.events_per_m) and self.events_per_m > 0.0):
            raise SlipControlError(
                f'{self.events_per_m:g} events per metre of motion: give a positive number'
            )


class AdvanceLaw:
    """Turns windows into a wanted advance, within limits that hold for every input.

    Attributes:
        total: Wanted advance since the last reset [m], 0 to the limit after each window.
        limit: Largest `total` [m], which may be set anew before each window.

    Args:
        settings: Gain and limits.
    """

    def __init__(self, settings: AdvanceSettings | None = None) -> None:
        self.settings = settings or AdvanceSettings()
        self.total = 0.0
        self.limit = self.settings.max_total
        self._preload: float | None = None
        self._held = 0
        self._excess = 0.0
        self._floor = 0.0
        self._backing_off = False

    @property
    def at_limit(self) -> bool:
        """Whether no advance is left."""
        return self.total >= self.limit

    def reset(self, limit: float = math.inf, preload: float | None = None) -> None:
        """Start over at the present position.

        Args:
            limit: Largest sum of advances [m], beside `max_total`.
            preload: Normal force to keep between slips [N]; None keeps none.

        Raises:
            SlipControlError: A limit that is negative or not a number.
        """
        if not limit >= 0.0:
            raise SlipControlError(
                f'an advance of at most {limit:g} m: the force is at its maximum already, lower '
                'the preload or raise max_force'
            )
        self.total = self._floor = 0.0
        self.limit = min(limit, self.settings.max_total)
        self._preload = preload
        self._held = 0
        self._excess = 0.0
        self._backing_off = False

    def update(self, count: int, threshold: float, force: float | None, *, slipping: bool) -> float:
        """Return the advance of a window [m]; negative only while backing off.

        Args:
            count: Events in the window, N_t.
            threshold: N_th.
            force: Normal force [N], None where none is known.
            slipping: Whether the object slips.
        """
        before = self.total
        wanted = self._on_slip(count, threshold) if slipping else self._at_rest(force)
        self.total = min(max(before + wanted, 0.0), max(self.limit, 0.0))
        return self.total - before

    def add(self, advance: float) -> None:
        """Take over an advance [m] >= 0 made for another reason; it is held as if by slip."""
        self.total += max(advance, 0.0)
        self._held = 0

    def _on_slip(self, count: int, threshold: float) -> float:
        """Return the paper's advance; what gave way to slip is not given up a second time."""
        if self._backing_off:
            self._floor = self.total
            self._backing_off = False
        self._held = 0
        settings = self.settings
        kept = 0.0
        if settings.memory_windows > 0.0:
            kept = math.exp(-1.0 / settings.memory_windows) * self._excess
        self._excess = max(count - threshold, kept, 0.0)
        per_event = settings.gain / settings.events_per_m
        return min(per_event * self._excess, settings.max_step)

    def _at_rest(self, force: float | None) -> float:
        settings = self.settings
        self._excess = 0.0
        self._held += 1
        if self._held <= settings.hold_windows or force is None or self._preload is None:
            return 0.0
        excess = force - self._preload
        if excess < -settings.force_band:
            return settings.preload_step
        if excess > settings.force_band and settings.back_off_step > 0.0:
            room = self.total - self._floor
            self._backing_off = self._backing_off or room > 0.0
            return -min(settings.back_off_step, max(room, 0.0))
        return 0.0
