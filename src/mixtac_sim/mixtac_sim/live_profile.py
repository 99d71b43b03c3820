# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A profile for a sensor that runs on and on: nothing touches it until a scenario is played."""

from __future__ import annotations

from threading import Lock
from typing import TYPE_CHECKING

import numpy as np

from mixtac_sim.contact_steps import STEP_US
from mixtac_sim.errors import SimulationError
from mixtac_sim.indenter import HEMISPHERE, WEIGHT_20_G

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_sim.indenter import Indenter
    from mixtac_sim.segments import Profile


class LiveProfile:
    """Hands the commands of a scenario to the simulation from the moment it is played.

    It has the interface of `mixtac_sim.segments.Profile`, with commands that are not known
    beforehand. `play` may be called from any thread.

    Attributes:
        name: Name of the profile.
        duration_s: Endless.
        indenters: Everything that scenarios may use.
    """

    name = 'live'
    duration_s = float('inf')
    indenters: tuple[Indenter, ...] = (HEMISPHERE, WEIGHT_20_G)

    def __init__(self) -> None:
        self._lock = Lock()
        self._scenario: Profile | None = None
        self._start_step = 0

    def play(self, scenario: Profile, start_us: int) -> None:
        """Play a scenario from a time [us, simulated time]; it replaces what is playing.

        Raises:
            SimulationError: It uses an indenter that the sensor was not prepared for.
        """
        unknown = set(scenario.indenters) - set(self.indenters)
        if unknown:
            raise SimulationError(
                f'scenario {scenario.name!r} uses {unknown.pop()}; the live sensor knows only '
                f'{self.indenters}'
            )
        with self._lock:
            self._scenario = scenario
            self._start_step = -(-start_us // STEP_US)

    def end_us(self) -> int | None:
        """Return when the latest scenario ends [us, simulated time], none before the first."""
        with self._lock:
            if self._scenario is None:
                return None
            return self._start_step * STEP_US + round(self._scenario.duration_s * 1e6)

    def commands(
        self, first: int, count: int
    ) -> tuple[NDArray[np.int8], NDArray[np.float64], NDArray[np.int8]]:
        """Return modes, targets and indenters of grid steps ``first`` to ``first + count``."""
        with self._lock:
            scenario, start = self._scenario, self._start_step
        modes, targets = np.zeros(count, np.int8), np.zeros(count)
        tools = np.zeros(count, np.int8)
        skip = max(start - first, 0)
        if scenario is None or skip >= count:
            return modes, targets, tools
        played = scenario.commands(first + skip - start, count - skip)
        places = np.array([self.indenters.index(tool) for tool in scenario.indenters], np.int8)
        modes[skip:], targets[skip:] = played[0], played[1]
        tools[skip:] = places[played[2]]
        return modes, targets, tools
