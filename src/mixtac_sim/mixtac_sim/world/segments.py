# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Commands of a contact: segments of force, position or drop, for a trial or live.

A `Profile` holds the segments of a whole trial. `LiveProfile` replaces it for the live sensor:
nothing touches the sensor until a scenario is played.
"""

from __future__ import annotations

from dataclasses import dataclass
from threading import Lock
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixtac_core.events.arrays import Floats
from mixtac_sim.grids import STEP_US
from mixtac_sim.mechanics.contact import Mode
from mixtac_sim.mechanics.elastomer import HEMISPHERE, WEIGHT_20_G, Indenter

SLOW_HZ = 40.0
"""Tones up to here are resolved by the steps that bead motion asks for."""
STEPS_PER_PERIOD = 12
"""Steps per period of a faster tone."""


@dataclass(frozen=True, slots=True)
class Tone:
    """A sinusoid added to a segment's target, faded in and out at its ends.

    Attributes:
        amplitude: Zero to peak, in the unit of the target.
        frequency_hz: Frequency [Hz].
        phase: Phase at the start of the segment [rad].
        fade_s: Length of the fades [s].
    """

    amplitude: float
    frequency_hz: float
    phase: float = 0.0
    fade_s: float = 0.1


Pulled = tuple[tuple[float, float], tuple[float, float]]
"""Force across the normal at the start and the end of a span, right and down [N]."""
FREE: Pulled = ((0.0, 0.0), (0.0, 0.0))
"""Nothing holds the indenter, nothing pulls at it."""


@dataclass(frozen=True, slots=True)
class Segment:
    """One command over a span of time.

    Attributes:
        start_s: Start [s] since the start of the trial.
        end_s: End [s].
        mode: Meaning of the target.
        times_s: Times of the target's knots [s] since the segment's start, increasing.
        values: Target at the knots; between them it moves with zero slope at each knot.
        tones: Sinusoids on top.
        indenter: The indenter.
        move: Its motion across the normal over the segment, from rest to rest: right and down
            [mm], and turn from right to down [rad]. It stays there afterwards.
        roll: How far the contact rolls over the segment, right and down [mm].
        pull: Force across the normal from the start to the end of the segment, right and down
            [N], as of a weight on a string; None where `move` says where the indenter is.
    """

    start_s: float
    end_s: float
    mode: Mode
    times_s: tuple[float, ...] = (0.0,)
    values: tuple[float, ...] = (0.0,)
    tones: tuple[Tone, ...] = ()
    indenter: Indenter = HEMISPHERE
    move: tuple[float, float, float] = (0.0, 0.0, 0.0)
    roll: tuple[float, float] = (0.0, 0.0)
    pull: Pulled | None = None

    def target(self, since_s: Floats) -> Floats:
        """Return the target at times since the segment's start [s]."""
        knots, values = np.array(self.times_s), np.array(self.values)
        k = np.clip(np.searchsorted(knots, since_s, side='right') - 1, 0, len(knots) - 1)
        after = np.minimum(k + 1, len(knots) - 1)
        span = np.maximum(knots[after] - knots[k], 1e-9)
        u = np.clip((since_s - knots[k]) / span, 0.0, 1.0)
        base = values[k] + (values[after] - values[k]) * u * u * (3.0 - 2.0 * u)
        total = np.zeros_like(since_s)
        left = self.end_s - self.start_s - since_s
        for tone in self.tones:
            fade = np.clip(np.minimum(since_s, left) / tone.fade_s, 0.0, 1.0)
            phase = 2.0 * np.pi * tone.frequency_hz * since_s + tone.phase
            total += tone.amplitude * fade**2 * np.sin(phase)
        return np.asarray(base + total)


Commands = tuple[NDArray[np.int8], Floats, NDArray[np.int8]]
"""Modes, targets and indenters of some grid steps."""


def still(count: int) -> Floats:
    """Return the motion of an indenter that is held, as `Profile.motion` does."""
    return np.tile([0.0, 0.0, 0.0, 0.0, 0.0, np.nan, np.nan], (count, 1))


@dataclass(frozen=True, slots=True)
class Profile:
    """Commands of a whole trial; outside its segments nothing touches.

    Attributes:
        duration_s: Length of the trial [s].
        segments: Commands in order of time, without overlap.
        sync_s: Centres of the synchronising impulses [s], for tests of the alignment.
    """

    duration_s: float
    segments: tuple[Segment, ...]
    sync_s: tuple[float, ...] = ()

    @property
    def indenters(self) -> tuple[Indenter, ...]:
        """Return every indenter once; commands refer to it by its place here."""
        found = dict.fromkeys(segment.indenter for segment in self.segments)
        return tuple(found) or (HEMISPHERE,)

    @property
    def goes_on(self) -> bool:
        """Whether it begins with a force: the indenter of what came before stays in contact."""
        return any(s.mode is Mode.FORCE and s.values[0] > 0.0 for s in self.segments[:1])

    def commands(self, first: int, count: int, indenters: tuple[Indenter, ...] = ()) -> Commands:
        """Return modes, targets and indenters of grid steps ``first`` to ``first + count``.

        The command of step k is the one in force at its end, (k + 1) * 125 us.

        Args:
            first: First grid step.
            count: Number of grid steps.
            indenters: What the numbers of indenters refer to, in place of `indenters`.
        """
        times = np.arange(first + 1, first + count + 1, dtype=np.float64) * (1e-6 * STEP_US)
        modes = np.zeros(count, np.int8)
        targets = np.zeros(count)
        tools = np.zeros(count, np.int8)
        indenters = indenters or self.indenters
        for segment in self.segments:
            if segment.start_s > times[-1] or segment.end_s < times[0]:
                continue
            inside = (times > segment.start_s) & (times <= segment.end_s)
            modes[inside] = segment.mode
            targets[inside] = segment.target(times[inside] - segment.start_s)
            tools[inside] = indenters.index(segment.indenter)
        return modes, targets, tools

    def motion(self, first: int, count: int) -> Floats | None:
        """Return the motion across the normal over grid steps ``first`` to ``first + count``.

        Returns:
            Right and down [mm], turn [rad], all nan where the indenter goes back to where the first
            contact was, rolling to the right and down [mm], and the pull to the right and down at
            the end of each step [N], nan where nothing pulls [count, 7]; None if nothing in the
            profile moves so.
        """
        moving = [s for s in self.segments if any(s.move) or any(s.roll) or s.pull]
        if not moving:
            return None
        times = np.arange(first, first + count + 1, dtype=np.float64) * (1e-6 * STEP_US)
        steps = still(count)
        for segment in moving:
            if segment.start_s < times[-1] and segment.end_s > times[0]:
                u = (times - segment.start_s) / (segment.end_s - segment.start_s)
                u = np.clip(u, 0.0, 1.0)
                share = u * u * (3.0 - 2.0 * u)
                steps[:, :5] += np.outer(np.diff(share), (*segment.move, *segment.roll))
                if segment.pull is not None:
                    inside = (times[1:] > segment.start_s) & (times[1:] <= segment.end_s)
                    first, last = np.array(segment.pull)
                    pull = first + np.outer(share[1:], last - first)
                    steps[inside, 5:] = pull[inside]
        return steps

    def longest_step(self, first: int, count: int) -> int:
        """Return how many of ``count`` grid steps from ``first`` on may be computed as one.

        Tones above ``SLOW_HZ`` move beads to and fro within a step that their net motion allows.
        """
        grid_s = 1e-6 * STEP_US
        fastest = max(
            (
                tone.frequency_hz
                for segment in self.segments
                for tone in segment.tones
                if segment.start_s < (first + count) * grid_s and segment.end_s > first * grid_s
            ),
            default=0.0,
        )
        if fastest <= SLOW_HZ:
            return count
        return max(int(1.0 / (STEPS_PER_PERIOD * fastest * grid_s)), 1)


MOST_PLAYS = 16
"""Scenarios that are kept: more than begin within the lead of a simulation."""


class Play(NamedTuple):
    """A scenario and the grid step at which it begins."""

    start: int
    scenario: Profile


class LiveProfile:
    """Hands the commands of scenarios to the simulation, each from the moment it is played.

    It has the interface of `Profile`, with commands that are not known
    in advance. A scenario lasts until the next one begins. `play` may be called from any thread.

    Args:
        indenters: Indenters that scenarios may use.

    Attributes:
        indenters: Indenters that scenarios may use.
        plays: The scenario under way and those around it, in order of time; replaced as a whole.
    """

    def __init__(self, indenters: tuple[Indenter, ...] = (HEMISPHERE, WEIGHT_20_G)) -> None:
        self.indenters = indenters
        self.plays: tuple[Play, ...] = ()
        self._playing = Lock()
        self._moves = False

    def play(self, scenario: Profile, start_us: int) -> None:
        """Play a scenario from a time [us, simulated time] on.

        It replaces what is playing then, and what was to begin later.
        """
        start = -(-start_us // STEP_US)
        with self._playing:
            earlier = [play for play in self.plays if play.start < start][-MOST_PLAYS + 1 :]
            self.plays = (*earlier, Play(start, scenario))

    def end_us(self) -> int | None:
        """Return when the latest scenario ends [us, simulated time], none before the first."""
        if not (plays := self.plays):
            return None
        start, scenario = plays[-1]
        return start * STEP_US + round(scenario.duration_s * 1e6)

    def force_at(self, t_us: int) -> tuple[float, Indenter | None]:
        """Return the force [N] commanded at a time [us, simulated time], and of what.

        Where no force is commanded it is 0, of nothing.
        """
        modes, targets, tools = self.commands(-(-t_us // STEP_US) - 1, 1)
        if modes[0] != Mode.FORCE:
            return 0.0, None
        return float(targets[0]), self.indenters[tools[0]]

    def pull_at(self, t_us: int) -> tuple[float, float]:
        """Return the force across the normal commanded at a time [us]; none where none is."""
        motion = self.motion(-(-t_us // STEP_US) - 1, 1)
        right, down = np.nan_to_num(still(1) if motion is None else motion)[0, 5:].tolist()
        return right, down

    def longest_step(self, first: int, count: int) -> int:
        """Return how many grid steps from ``first`` on may be computed as one."""
        longest = count
        for begin, end, play in self._spans(first, count):
            longest = min(longest, play.scenario.longest_step(begin - play.start, end - begin))
        return longest

    def motion(self, first: int, count: int) -> Floats | None:
        """Return the motion across the normal; as in `Profile`.

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
        modes, targets = np.zeros(count, np.int8), np.zeros(count)
        tools = np.zeros(count, np.int8)
        for begin, end, play in self._spans(first, count):
            given = play.scenario.commands(begin - play.start, end - begin, self.indenters)
            span = slice(begin - first, end - first)
            modes[span], targets[span], tools[span] = given
        return modes, targets, tools

    def _spans(self, first: int, count: int) -> list[tuple[int, int, Play]]:
        """Return which scenario commands which grid steps, as (begin, end, play)."""
        plays = self.plays
        ends = [*(play.start for play in plays[1:]), first + count]
        spans = [
            (max(play.start, first), min(end, first + count), play)
            for play, end in zip(plays, ends, strict=False)
        ]
        return [span for span in spans if span[0] < span[1]]
