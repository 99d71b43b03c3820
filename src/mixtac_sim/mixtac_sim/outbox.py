# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Holds what whole blocks have produced until it is asked for up to some time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from mixtac_events.arrays import Events

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_sim.aps import ApsFrame
    from mixtac_sim.touch import ContactBlock


class Outbox:
    """Output that is ready or not yet due; all times true time [us].

    Attributes:
        frames: Frames in order of their ends; append to it.
    """

    def __init__(self) -> None:
        self.frames: list[ApsFrame] = []
        self._events: list[Events] = []
        self._blocks: list[ContactBlock] = []

    def put(self, events: Events, contact: ContactBlock) -> None:
        """Add the events and the contact of a block."""
        self._events.append(events)
        self._blocks.append(contact)

    def take(
        self, until_us: int
    ) -> tuple[
        Events,
        list[ApsFrame],
        NDArray[np.void],
        NDArray[np.int64],
        NDArray[np.float64],
    ]:
        """Return and forget events, frames, truth, wrench times and wrenches before a time."""
        frames = [frame for frame in self.frames if frame.frame_end_us < until_us]
        self.frames = self.frames[len(frames) :]
        return (self._take_events(until_us), frames, *self._take_contact(until_us))

    def _take_events(self, until_us: int) -> Events:
        events = Events.concatenate(self._events)
        split = int(np.searchsorted(events.t, until_us))
        self._events = [events[split:]] if split < len(events) else []
        return events[:split]

    def _take_contact(
        self, until_us: int
    ) -> tuple[NDArray[np.void], NDArray[np.int64], NDArray[np.float64]]:
        """Return truth and wrenches of this call; only the last block may be split."""
        raise NotImplementedError
