# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Features of event windows: counts, and how the skin moved, straight from decoded packets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from mixtac_events.windows import WindowSlicer
from mixtac_slip_control.flow_guide import BIN, MODES, GuideSettings
from mixtac_slip_control.slip_kernels import window_sums

if TYPE_CHECKING:
    from mixtac_events.arrays import Events
    from mixtac_slip_control.flow_guide import FlowGuide

MAX_EMPTY_RUN: Final = 20
"""After a gap only this many empty windows are handed out: old news helps nobody."""
STALE_GUIDE_US: Final = 500_000
"""A frame older than this guides no more."""


@dataclass(frozen=True, slots=True)
class SlipWindow:
    """One counting window.

    Attributes:
        end_us: Its end, camera clock [us].
        count: Events in it.
        on: ON events in it.
        flow_x: Translation of the skin at the contact to the right [px per contrast threshold].
        flow_y: The same downwards.
        pressing: Motion away from the contact, at the reach of the guide, same unit.
        guided: Whether a frame was there to tell motion by; else the three above are 0.
        complete: False where packets of the window were lost.
    """

    end_us: int
    count: int
    on: int
    flow_x: float
    flow_y: float
    pressing: float
    guided: bool
    complete: bool


class SlipFeatures:
    """Cuts an event stream into windows and computes their features.

    Args:
        window_us: Width of a window [us].
        settings: Of the guides that will come.

    Attributes:
        slicer: Counts what was late, skipped or restarted.
    """

    def __init__(self, window_us: int = 1000, settings: GuideSettings | None = None) -> None:
        shape = settings or GuideSettings()
        self.slicer = WindowSlicer(window_us, max_empty_run=MAX_EMPTY_RUN)
        self._guide: FlowGuide | None = None
        self._blank = np.zeros((MODES, shape.height // BIN, shape.width // BIN), np.float32)
        self._sums = np.zeros(MODES)
        self._lost_until_us = 0
        self.warm_up()

    def warm_up(self) -> None:
        """Compile (or load) the kernel."""
        none16, none = np.empty(0, np.uint16), np.empty(0, np.bool_)
        window_sums(none16, none16, none, self._blank, BIN, self._sums)

    def guide(self, guide: FlowGuide | None) -> None:
        """Use a frame's guide from now on; None goes on without."""
        self._guide = guide

    def lost_before(self, time_us: int) -> None:
        """Note that events before a time (camera clock [us]) are missing."""
        self._lost_until_us = time_us

    def push(self, events: Events, complete_until: int) -> list[SlipWindow]:
        """Add the next events and return the windows that they close, in order.

        Args:
            events: Camera clock [us]; may be empty.
            complete_until: Camera clock [us]: no event before this time will follow.
        """
        return [
            self._features(end_us, window)
            for end_us, window in self.slicer.push(events, complete_until)
        ]

    def _features(self, end_us: int, events: Events) -> SlipWindow:
        guide = self._guide
        fresh = guide is not None and abs(end_us - guide.frame_us) <= STALE_GUIDE_US
        fields = guide.fields if guide is not None and fresh else self._blank
        on = window_sums(events.x, events.y, events.polarity, fields, BIN, self._sums)
        motion = -(guide.solver @ self._sums) if guide is not None and fresh else self._sums
        return SlipWindow(
            end_us=end_us,
            count=len(events),
            on=int(on),
            flow_x=float(motion[0]),
            flow_y=float(motion[1]),
            pressing=float(motion[2]),
            guided=fresh,
            complete=end_us - self.slicer.width_us >= self._lost_until_us,
        )
