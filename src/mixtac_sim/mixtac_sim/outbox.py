# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Holds what whole blocks have produced until it is asked for up to some time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mixtac_events.arrays import Events
from mixtac_sim.touch import TRUTH_DTYPE

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_sim.aps import ApsFrame
    from mixtac_sim.touch import ContactBlock

    _Contact = tuple[NDArray[np.void], NDArray[np.int64], NDArray[np.float64]]
    _Taken = tuple[Events, list[ApsFrame], NDArray[np.void], NDArray[np.int64], NDArray[np.float64]]


class Outbox:
    """Output that is ready but may not be due; all times are true time [us].

    Attributes:
        frames: Frames in order of their ends; append to it.
    """

    def __init__(self) -> None:
        self.frames: list[ApsFrame] = []
        self._events: list[Events] = []
        self._truth = [np.empty(0, TRUTH_DTYPE)]
        self._times = [np.empty(0, np.int64)]
        self._wrenches = [np.empty((0, 6))]

    def put(self, events: Events, contact: ContactBlock) -> None:
        """Add the events and the contact of a block."""
        self._events.append(events)
        self._truth.append(contact.truth())
        self._times.append(contact.t_us)
        self._wrenches.append(contact.wrench)

    def take(self, until_us: int) -> _Taken:
        """Return and forget events, frames, truth, wrench times and wrenches before a time."""
        frames = [frame for frame in self.frames if frame.frame_end_us < until_us]
        self.frames = self.frames[len(frames) :]
        return (self._take_events(until_us), frames, *self._take_contact(until_us))

    def _take_events(self, until_us: int) -> Events:
        events = Events.concatenate(self._events)
        split = int(np.searchsorted(events.t, until_us))
        self._events = [events[split:]]
        return events[:split]

    def _take_contact(self, until_us: int) -> _Contact:
        truth, times = np.concatenate(self._truth), np.concatenate(self._times)
        wrenches = np.concatenate(self._wrenches)
        row = int(np.searchsorted(truth['t_us'], until_us))
        split = int(np.searchsorted(times, until_us))
        self._truth, self._times = [truth[row:]], [times[split:]]
        self._wrenches = [wrenches[split:]]
        return truth[:row], times[:split], wrenches[:split]
