# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Contacts of the live sensor on request: press, pull, load, drop, vibrate, follow, release.

Each request becomes a short profile that is played at once. `LiveProfile` replaces the fixed
profile of a trial; nothing touches the sensor until it plays.
"""

from __future__ import annotations

from dataclasses import replace
from threading import Lock
from typing import Final, NamedTuple

import numpy as np

from mixtac_events.arrays import Floats
from mixtac_sim import SimulationError
from mixtac_sim.grids import STEP_US
from mixtac_sim.mechanics.contact import GRAVITY, Mode
from mixtac_sim.mechanics.indenters import HEMISPHERE, WEIGHT_20_G, Indenter
from mixtac_sim.world.segments import Commands, Profile, Pulled, Segment, Tone, still

RAMP_S: Final = 0.2
"""Time in which an object approaches or leaves [s]."""
FOLLOW_RAMP_S: Final = 0.01
"""Time in which a commanded force is reached [s]."""
FOLLOW_TIMEOUT_S: Final = 0.25
"""Time for which a commanded force is held without a new command [s]."""
APART_MM: Final = 0.3
"""Distance from the skin at which a vibration starts and ends [mm]."""
MOVE_S: Final = 1.0
"""Time of a motion across the normal [s]."""


def press(
    tool: Indenter, force_n: float, hold_s: float, move: tuple[float, float, float] = (0, 0, 0)
) -> Profile:
    """Return a press with a force that is held, moved across the normal first if it is to be.

    Args:
        tool: The object.
        force_n: Force [N].
        hold_s: Duration of the hold, at rest [s].
        move: Motion: right and down [mm], turn from right to down [rad]; undone in the air.
    """
    down = RAMP_S
    rest = RAMP_S + MOVE_S * any(move)
    up, end = rest + hold_s, rest + hold_s + RAMP_S
    segments = [
        Segment(0.0, down, Mode.FORCE, (0.0, RAMP_S), (0.0, force_n), indenter=tool),
        Segment(rest, up, Mode.FORCE, (0.0,), (force_n,), indenter=tool),
        Segment(up, end, Mode.FORCE, (0.0, RAMP_S), (force_n, 0.0), indenter=tool),
    ]
    if any(move):
        back = (-move[0], -move[1], -move[2])
        moved = Segment(down, rest, Mode.FORCE, (0.0,), (force_n,), indenter=tool, move=move)
        segments.insert(1, moved)
        segments.append(Segment(end, end + RAMP_S, Mode.FREE, indenter=tool, move=back))
        end += RAMP_S
    return Profile('press', end, tuple(segments))


def pull(
    tool: Indenter,
    force_n: tuple[float, float],
    pull_n: Pulled,
    hold_s: float,
) -> Profile:
    """Return a press that a force pulls aside, as a weight on a thread would; then it is let go.

    Args:
        tool: The object.
        force_n: Normal force before and after [N].
        pull_n: Force across the normal before and after [N].
        hold_s: Duration of the hold [s].
    """
    _, after = force_n
    first, last = pull_n
    down, rest = RAMP_S, RAMP_S + MOVE_S * (first != last)
    up, end = rest + hold_s, rest + hold_s + RAMP_S
    segments = [
        Segment(0.0, down, Mode.FORCE, (0.0, RAMP_S), force_n, indenter=tool, pull=(first, first)),
        Segment(rest, up, Mode.FORCE, (0.0,), (after,), indenter=tool, pull=(last, last)),
        Segment(up, end, Mode.FORCE, (0.0, RAMP_S), (after, 0.0), indenter=tool),
    ]
    if rest > down:
        way = Segment(down, rest, Mode.FORCE, (0.0,), (after,), indenter=tool, pull=pull_n)
        segments.insert(1, way)
    return Profile('pull', end, tuple(segments))


def load(tool: Indenter, hold_s: float) -> Profile:
    """Return an object that is put down gently and taken off after some time [s].

    Raises:
        SimulationError: The object has no mass.
    """
    if tool.mass_g <= 0.0:
        raise SimulationError(f'{tool} has no weight to put down: choose an object with a mass')
    return replace(press(tool, 1e-3 * tool.mass_g * GRAVITY, hold_s), name='load')


def drop(tool: Indenter, height_mm: float, hold_s: float) -> Profile:
    """Return an object that falls from a height [mm], rests for some time [s] and is lifted.

    Raises:
        SimulationError: The object has no mass.
    """
    # What fell before must have left the skin.
    begin, lift = RAMP_S, RAMP_S + hold_s
    pull = 1.3e-3 * tool.mass_g * GRAVITY
    segments = (
        Segment(begin, lift, Mode.DROP, (0.0,), (height_mm,), indenter=tool),
        Segment(lift, lift + RAMP_S, Mode.LIFT, (0.0, RAMP_S), (0.0, pull), indenter=tool),
    )
    return Profile('drop', lift + RAMP_S, segments)


def vibrate(
    tool: Indenter, depth_mm: float, amplitude_mm: float, frequency_hz: float, hold_s: float
) -> Profile:
    """Return an object that vibrates in the skin.

    Args:
        tool: The object.
        depth_mm: Mean depth [mm].
        amplitude_mm: Zero to peak [mm].
        frequency_hz: Frequency [Hz].
        hold_s: Duration [s].

    Raises:
        SimulationError: It would leave the skin.
    """
    if amplitude_mm >= depth_mm:
        raise SimulationError(
            f'amplitude {amplitude_mm} mm at a depth of {depth_mm} mm would leave the skin: '
            'take less, or go deeper'
        )
    tone = Tone(amplitude_mm, frequency_hz, 0.0, min(0.05, 0.25 * hold_s))
    down, up = RAMP_S, RAMP_S + hold_s
    segments = (
        Segment(0.0, down, Mode.POSITION, (0.0, RAMP_S), (-APART_MM, depth_mm), indenter=tool),
        Segment(down, up, Mode.POSITION, (0.0,), (depth_mm,), (tone,), tool),
        Segment(up, up + RAMP_S, Mode.POSITION, (0.0, RAMP_S), (depth_mm, -APART_MM), (), tool),
    )
    return Profile('vibrate', up + RAMP_S, segments)


def follow(tool: Indenter, from_n: float, force_n: float) -> Profile:
    """Return a force [N] that is reached quickly from another and fades without a new command."""
    first, last = FOLLOW_RAMP_S, FOLLOW_RAMP_S + FOLLOW_TIMEOUT_S
    segments = (
        Segment(0.0, first, Mode.FORCE, (0.0, FOLLOW_RAMP_S), (from_n, force_n), indenter=tool),
        Segment(first, last, Mode.FORCE, (0.0,), (force_n,), indenter=tool),
        Segment(last, last + RAMP_S, Mode.FORCE, (0.0, RAMP_S), (force_n, 0.0), indenter=tool),
    )
    return Profile('follow', last + RAMP_S, segments)


def release(tool: Indenter, from_n: float) -> Profile:
    """Return the release from a force [N]."""
    way = Segment(0.0, RAMP_S, Mode.FORCE, (0.0, RAMP_S), (from_n, 0.0), indenter=tool)
    return Profile('release', RAMP_S, (way,) if from_n > 0.0 else ())


class Play(NamedTuple):
    """A scenario and the grid step at which it begins."""

    start: int
    scenario: Profile


class LiveProfile:
    """Hands the commands of scenarios to the simulation, each from the moment it is played.

    It has the interface of `mixtac_sim.world.segments.Profile`, with commands that are not known
    in advance. A scenario lasts until the next one begins. `play` may be called from any thread.

    Args:
        indenters: Indenters that scenarios may use.

    Attributes:
        indenters: Indenters that scenarios may use.
    """

    def __init__(self, indenters: tuple[Indenter, ...] = (HEMISPHERE, WEIGHT_20_G)) -> None:
        self.indenters = indenters
        self._lock = Lock()
        # The one under way and those to come.
        self._plays: list[Play] = []
        self._asked = 0
        self._changed = self._moves = False

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
            self._plays.append(Play(start, scenario))
            self._changed = True
            self._forget()

    def changes(self, until_us: int) -> list[Play] | None:
        """Return what is played, None if that has not changed since the last call.

        Args:
            until_us: Simulated time [us] up to which commands have been asked for elsewhere.
        """
        with self._lock:
            self._asked = max(self._asked, until_us // STEP_US)
            changed, self._changed = self._changed, False
            return list(self._plays) if changed else None

    def replace(self, plays: list[Play]) -> None:
        """Play what `changes` of another profile returned."""
        with self._lock:
            self._plays = plays

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

    def pull_at(self, t_us: int) -> tuple[float, float]:
        """Return the force across the normal commanded at a time [us]; none where none is."""
        motion = self.motion(-(-t_us // STEP_US) - 1, 1)
        right, down = np.nan_to_num(still(1) if motion is None else motion)[0, 5:].tolist()
        return right, down

    def longest_step(self, first: int, count: int) -> int:
        """Return the most grid steps that may be taken at once from ``first`` on."""
        longest = count
        for begin, end, play in self._spans(first, count):
            longest = min(longest, play.scenario.longest_step(begin - play.start, end - begin))
        return longest

    def motion(self, first: int, count: int) -> Floats | None:
        """Return the motion across the normal; as in `mixtac_sim.world.segments.Profile`.

        What touches anew begins where the first contact was.
        """
        steps = still(count)
        for begin, end, play in self._spans(first, count):
            part = play.scenario.motion(begin - play.start, end - begin)
            if part is not None:
                steps[begin - first : end - first] = part
                # Skin that was pulled aside keeps that state.
                self._moves = True
            if begin == play.start and not play.scenario.goes_on:
                steps[begin - first, :3] = np.nan
        return steps if self._moves else None

    def commands(self, first: int, count: int) -> Commands:
        """Return modes, targets and indenters of grid steps ``first`` to ``first + count``."""
        with self._lock:
            self._asked = max(self._asked, first)
        return self._commands(first, count)

    def _commands(self, first: int, count: int) -> Commands:
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

    def _spans(self, first: int, count: int) -> list[tuple[int, int, Play]]:
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
