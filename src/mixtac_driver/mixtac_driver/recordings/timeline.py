# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""From recorded pieces to short steps of a time that never goes back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mixtac_driver.decoder import DecodedBatch
from mixtac_driver.readings import NO_EDGES, NO_SAMPLES
from mixtac_driver.recordings.pieces import RESTART_US
from mixtac_events.arrays import Events

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mixtac_driver.recordings.pieces import Piece

GAP_US = 1000
"""Time from the end of one stretch to the beginning of the next, where recorded time goes back."""
MOST_AHEAD_US = 10_000_000
"""A frame or sample further ahead than this has a stamp of another clock: it does not wait."""
_NOTHING = Events.empty()


def whole_ms(t_us: int) -> int:
    """Round up to whole milliseconds: shifts by those keep packets on the grid they came on."""
    return -(-t_us // 1000) * 1000


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """A stretch to hand on at once.

    Attributes:
        due_us: When [us, recorded camera clock plus `offset_us`].
        offset_us: Add it to the times of `decoded` to get times that never go back.
        decoded: What to hand on, on the recorded camera clock.
    """

    due_us: int
    offset_us: int
    decoded: DecodedBatch


@dataclass(slots=True)
class Disorder:
    """What was found amiss with the order of recorded times.

    Attributes:
        resets: How often the recorded clock went back to begin anew.
        late_events: Events dropped because time had passed them.
        unsorted_events: Events that came before an earlier one of their packet; sorted.
    """

    resets: int = 0
    late_events: int = 0
    unsorted_events: int = 0


class Timeline:
    """Cuts pieces into steps.

    Args:
        start_us: Time to begin at [us, recorded camera clock].
        step_us: Longest step; 0 for steps as long as the pieces are. May be changed.
        disorder: Where to count what is amiss.

    Attributes:
        position_us: Time reached [us, recorded camera clock plus `offset_us`].
        disorder: As given.
        offset_us: Grows when the recorded clock was reset, so that time goes on.
    """

    def __init__(self, start_us: int, step_us: int, disorder: Disorder) -> None:
        self.step_us = step_us
        self.position_us = start_us
        self.offset_us = 0
        self.disorder = disorder
        self._pace_us = start_us

    def steps(self, piece: Piece) -> Iterator[Step]:
        """Yield the steps that a piece makes; take them all before the next piece."""
        if not piece.advances:
            yield self._aside(piece)
            return
        if piece.until_us + self.offset_us < self.position_us - RESTART_US:
            self.offset_us = whole_ms(self.position_us + GAP_US - piece.start_us)
            self.disorder.resets += 1
        events = self._in_time(piece.events)
        start_us, until_us = piece.start_us + self.offset_us, piece.until_us + self.offset_us
        if len(events):
            # Where they had to be sorted, the last was not the latest.
            until_us = max(until_us, int(events.t[-1]) + self.offset_us)
        yield from self._silence(start_us)
        taken = 0
        while self.step_us and (end_us := self._next_us()) < until_us:
            last = int(np.searchsorted(events.t, end_us - self.offset_us))
            yield self._step(end_us, events[taken:last])
            taken = last
        yield self._step(max(until_us, self.position_us), events[taken:], piece)

    def _silence(self, until_us: int) -> Iterator[Step]:
        while self.step_us and (end_us := self._next_us()) <= until_us:
            yield self._step(end_us, _NOTHING)

    def _next_us(self) -> int:
        return (self.position_us // self.step_us + 1) * self.step_us

    def _aside(self, piece: Piece) -> Step:
        # What was recorded behind later events is due with them.
        due_us = max(piece.start_us + self.offset_us, self.position_us)
        if due_us > self._pace_us + MOST_AHEAD_US:
            due_us = self._pace_us
        self._pace_us = max(self._pace_us, due_us)
        return Step(due_us, self.offset_us, self._decoded(_NOTHING, piece))

    def _step(self, time_us: int, events: Events, piece: Piece | None = None) -> Step:
        self.position_us = time_us
        self._pace_us = max(self._pace_us, time_us)
        return Step(time_us, self.offset_us, self._decoded(events, piece))

    def _decoded(self, events: Events, piece: Piece | None) -> DecodedBatch:
        return DecodedBatch(
            events=events,
            frames=piece.frames if piece else (),
            imu=piece.imu if piece else NO_SAMPLES,
            edges=piece.edges if piece else NO_EDGES,
            time_us=self.position_us - self.offset_us,
            resets=self.disorder.resets,
        )

    def _in_time(self, events: Events) -> Events:
        backwards = np.count_nonzero(events.t[1:] < events.t[:-1])
        if backwards:
            self.disorder.unsorted_events += int(backwards)
            events = events[np.argsort(events.t, kind='stable')]
        late = int(np.searchsorted(events.t, self.position_us - self.offset_us))
        self.disorder.late_events += late
        return events[late:]
