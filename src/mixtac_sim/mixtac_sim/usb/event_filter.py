# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The event filters of the FPGA that the virtual camera has: region, pixels, polarity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mixtac_events.arrays import Events
from mixtac_sim.usb.registers import HEIGHT, WIDTH, Dvs, Module

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_sim.usb.registers import RegisterFile

_FILTER_REGISTERS = range(Dvs.FIRST_PIXEL_ROW, Dvs.SUPPRESS_TYPE + 1)


def is_filter_register(module: int, param: int) -> bool:
    """Whether writing this register can change what the filters pass."""
    return module == Module.DVS and param in _FILTER_REGISTERS


@dataclass(frozen=True, slots=True, eq=False)
class EventFilter:
    """The filter settings at one moment, ready to apply.

    Attributes:
        keep: Pixels inside the region, ``bool [260, 346]``.
        muted: Pixels switched off by the pixel filter, ``bool [260, 346]``.
        flatten: Send every event as OFF.
        suppressed: Polarity that is not sent, or none.
        idle: Whether nothing is filtered at all.
    """

    keep: NDArray[np.bool_]
    muted: NDArray[np.bool_]
    flatten: bool
    suppressed: bool | None
    idle: bool

    @classmethod
    def from_registers(cls, registers: RegisterFile) -> EventFilter:
        """Read the settings; regions and pixels are in user orientation, ends inclusive."""

        def read(param: int) -> int:
            return registers.read(Module.DVS, param)

        keep = np.zeros((HEIGHT, WIDTH), np.bool_)
        rows = slice(read(Dvs.ROI_START_ROW), read(Dvs.ROI_END_ROW) + 1)
        keep[rows, read(Dvs.ROI_START_COLUMN) : read(Dvs.ROI_END_COLUMN) + 1] = True
        muted = np.zeros((HEIGHT, WIDTH), np.bool_)
        for k in range(8):
            row = read(Dvs.FIRST_PIXEL_ROW + 2 * k)
            column = read(Dvs.FIRST_PIXEL_ROW + 2 * k + 1)
            if row < HEIGHT and column < WIDTH:
                muted[row, column] = True
        suppressed = bool(read(Dvs.SUPPRESS_TYPE)) if read(Dvs.SUPPRESS) else None
        flatten = bool(read(Dvs.FLATTEN))
        idle = bool(keep.all()) and not muted.any() and suppressed is None and not flatten
        return cls(keep, muted, flatten, suppressed, idle)

    def apply(self, events: Events) -> tuple[Events, int]:
        """Return the events that pass and how many the pixel filter took."""
        inside = (events.x < WIDTH) & (events.y < HEIGHT)
        if not inside.all():
            events = events[inside]
        if self.idle:
            return events, 0
        passing = self.keep[events.y, events.x]
        muted = self.muted[events.y, events.x]
        filtered = int(np.count_nonzero(passing & muted))
        passing &= ~muted
        if self.suppressed is not None:
            passing &= events.polarity != self.suppressed
        if not passing.all():
            events = events[passing]
        if self.flatten:
            off = np.zeros(len(events), np.bool_)
            events = Events(events.t, events.x, events.y, off)
        return events, filtered
