# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A profile for a sensor that runs on and on: nothing touches it until a scenario is played."""

from __future__ import annotations

from threading import Lock
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mixtac_sim.contact import Mode
from mixtac_sim.contact_steps import STEP_US
from mixtac_sim.errors import SimulationError
from mixtac_sim.indenter import HEMISPHERE, WEIGHT_20_G

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_sim.indenter import Indenter
    from mixtac_sim.segments import Profile


class _Play(NamedTuple):
    """A scenario and the grid step at which it begins."""

    start: int
    scenario: Profile


class LiveProfile:
    """Hands the commands of scenarios to the simulation, each from the moment it is played.

    It has the interface of `mixtac_sim.segments.Profile`, with commands that are not known
    beforehand. A scenario goes on until the next one begins. `play` may be called from any thread.

    Args:
        indenters: Everything that scenarios may use.

    Attributes:
        name: Name of the profile.
        duration_s: Endless.
        indenters: Everything that scenarios may use.
    """

    name = 'live'
    duration_s = float('inf')

    def __init__(self, indenters: tuple[Indenter, ...] = (HEMISPHERE, WEIGHT_20_G)) -> None:
        self.indenters = indenters
        self._lock = Lock()
        # The one under way and those to come.
        self._plays: list[_Play] = []
        self._asked = 0

    def play(self, scenario: Profile, start_us: int) -> None:
        """Play a scenario from a time [us, simulated time] on.

        It replaces what is playing then, and what was to begin later.

        Raises:
            SimulationError: It uses an indenter that the sensor was not prepared for.
        """
        unknown = set(scenario.indenters) - set(self.indenters)
        if unknown:
            raise SimulationError(
                f'scenario {scenario.name!r} uses {unknown.pop()}; the live sensor knows only '
                f'{self.indenters}'
            )
        start = -(-start_us // STEP_US)
        with self._lock:
            self._plays = [play for play in self._plays if play.start < start]
            self._plays.append(_Play(start, scenario))
            self._forget()

    def end_us(self) -> int | None:
        """Return when the latest scenario ends [us, simulated time], none before the first."""
        with self._lock:
            if not self._plays:
                return None
            start, scenario = self._plays[-1]
            return start * STEP_US + round(scenario.duration_s * 1e6)

    def force_at(self, t_us: int) -> tuple[float, Indenter | None]:
        """Return the force [N] commanded at a time [us, simulated time], and of what.

        Where no force is commanded it is 0, of nothing.
        """
        modes, targets, tools = self._commands(-(-t_us // STEP_US) - 1, 1)
        if modes[0] != Mode.FORCE:
            return 0.0, None
        return float(targets[0]), self.indenters[tools[0]]

    def longest_step(self, first: int, count: int) -> int:
        """Return the most grid steps that may be taken at once from ``first`` on."""
        longest = count
        for begin, end, play in self._spans(first, count):
            longest = min(longest, play.scenario.longest_step(begin - play.start, end - begin))
        return longest

    def commands(
        self, first: int, count: int
    ) -> tuple[NDArray[np.int8], NDArray[np.float64], NDArray[np.int8]]:
        """Return modes, targets and indenters of grid steps ``first`` to ``first + count``."""
        with self._lock:
            self._asked = max(self._asked, first)
        return self._commands(first, count)

    def _commands(
        self, first: int, count: int
    ) -> tuple[NDArray[np.int8], NDArray[np.float64], NDArray[np.int8]]:
        modes, targets = np.zeros(count, np.int8), np.zeros(count)
        tools = np.zeros(count, np.int8)
        for begin, end, play in self._spans(first, count):
            played = play.scenario.commands(begin - play.start, end - begin)
            places = np.array(
                [self.indenters.index(tool) for tool in play.scenario.indenters], np.int8
            )
            span = slice(begin - first, end - first)
            modes[span], targets[span], tools[span] = played[0], played[1], places[played[2]]
        return modes, targets, tools

    def _spans(self, first: int, count: int) -> list[tuple[int, int, _Play]]:
        """Return which scenario commands which grid steps, as (begin, end, play)."""
        with self._lock:
            plays = list(self._plays)
        ends = [play.start for play in plays[1:]] + [first + count]
        spans = [
            (max(play.start, first), min(end, first + count), play)
            for play, end in zip(plays, ends, strict=False)
        ]
        return [span for span in spans if span[0] < span[1]]

    def _forget(self) -> None:
        """Drop scenarios that were replaced before the simulation's present."""
        while len(self._plays) > 1 and self._plays[1].start <= self._asked:
            del self._plays[0]
