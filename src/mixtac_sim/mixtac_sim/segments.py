# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Pieces of a contact profile: what is commanded from when to when."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

import numpy as np

from mixtac_sim.contact import Mode
from mixtac_sim.contact_steps import STEP_US
from mixtac_sim.errors import SimulationError
from mixtac_sim.indenter import HEMISPHERE, Indenter

if TYPE_CHECKING:
    from numpy.typing import NDArray


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


@dataclass(frozen=True, slots=True)
class Segment:
    """One command over a span of time.

    Attributes:
        start_s: Begin [s] since the start of the trial.
        end_s: End [s].
        mode: What the target means.
        times_s: Times of the target's knots [s] since the segment's start, increasing.
        values: Target at the knots; between them it moves with zero slope at each knot.
        tones: Sinusoids on top.
        indenter: What touches.
    """

    start_s: float
    end_s: float
    mode: Mode
    times_s: tuple[float, ...] = (0.0,)
    values: tuple[float, ...] = (0.0,)
    tones: tuple[Tone, ...] = ()
    indenter: Indenter = HEMISPHERE

    def __post_init__(self) -> None:
        """Refuse segments that end before they start or have unpaired knots.

        Raises:
            SimulationError: As above, or something without a mass is to fall.
        """
        if self.end_s <= self.start_s or len(self.times_s) != len(self.values):
            msg = (
                f'segment from {self.start_s} s to {self.end_s} s with {len(self.times_s)} times '
                f'and {len(self.values)} values; it must end after its start, with paired knots'
            )
            raise SimulationError(msg)
        if self.mode >= Mode.DROP and self.indenter.mass_g <= 0.0:
            msg = f'{self.indenter} cannot be dropped; give it a mass'
            raise SimulationError(msg)

    @property
    def fastest_hz(self) -> float:
        """Return the highest frequency of its tones [Hz], 0 without any."""
        return max((tone.frequency_hz for tone in self.tones), default=0.0)

    def target(self, since_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the target at times since the segment's start [s]."""
        knots, values = np.array(self.times_s), np.array(self.values)
        k = np.clip(np.searchsorted(knots, since_s, side='right') - 1, 0, len(knots) - 1)
        after = np.minimum(k + 1, len(knots) - 1)
        span = np.maximum(knots[after] - knots[k], 1e-9)
        u = np.clip((since_s - knots[k]) / span, 0.0, 1.0)
        base = values[k] + (values[after] - values[k]) * u * u * (3.0 - 2.0 * u)
        return np.asarray(base + self._tones(since_s))

    def _tones(self, since_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the sum of the tones."""
        total = np.zeros_like(since_s)
        left = self.end_s - self.start_s - since_s
        for tone in self.tones:
            fade = np.clip(np.minimum(since_s, left) / tone.fade_s, 0.0, 1.0)
            phase = 2.0 * np.pi * tone.frequency_hz * since_s + tone.phase
            total += tone.amplitude * fade**2 * np.sin(phase)
        return total


class CommandSource(Protocol):
    """What the sensor needs of a profile."""

    @property
    def indenters(self) -> tuple[Indenter, ...]:
        """Return everything that may touch."""

    def commands(
        self, first: int, count: int
    ) -> tuple[NDArray[np.int8], NDArray[np.float64], NDArray[np.int8]]:
        """Return modes, targets and indenters of some grid steps."""

    def longest_step(self, first: int, count: int) -> int:
        """Return the most grid steps that may be taken at once among some."""


@dataclass(frozen=True, slots=True)
class Profile:
    """Commands of a whole trial; where no segment speaks, nothing touches.

    Attributes:
        name: Name of the profile.
        duration_s: Length of the trial [s].
        segments: Commands in order of time, without overlap.
        sync_s: Centres of the synchronising impulses [s], for tests of the alignment.
    """

    name: str
    duration_s: float
    segments: tuple[Segment, ...]
    sync_s: tuple[float, ...] = ()
    _starts: tuple[float, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Refuse overlapping segments.

        Raises:
            SimulationError: A segment starts before its predecessor ends.
        """
        for earlier, later in zip(self.segments, self.segments[1:], strict=False):
            if later.start_s < earlier.end_s - 1e-9:
                msg = (
                    f'segment at {later.start_s} s of profile {self.name!r} starts before '
                    f'{earlier.end_s} s, where the one before it ends; move it'
                )
                raise SimulationError(msg)
        object.__setattr__(self, '_starts', tuple(s.start_s for s in self.segments))

    @property
    def indenters(self) -> tuple[Indenter, ...]:
        """Return every indenter once; commands refer to it by its place here."""
        found = dict.fromkeys(segment.indenter for segment in self.segments)
        return tuple(found) or (HEMISPHERE,)

    def commands(
        self, first: int, count: int
    ) -> tuple[NDArray[np.int8], NDArray[np.float64], NDArray[np.int8]]:
        """Return modes, targets and indenters of grid steps ``first`` to ``first + count``.

        The command of step k is the one in force at its end, (k + 1) * 125 us.
        """
        times = np.arange(first + 1, first + count + 1, dtype=np.float64) * (1e-6 * STEP_US)
        modes = np.zeros(count, np.int8)
        targets = np.zeros(count)
        tools = np.zeros(count, np.int8)
        indenters = self.indenters
        begin = max(int(np.searchsorted(self._starts, times[0], side='right')) - 1, 0)
        for segment in self.segments[begin:]:
            if segment.start_s > times[-1]:
                break
            inside = (times > segment.start_s) & (times <= segment.end_s)
            modes[inside] = segment.mode
            targets[inside] = segment.target(times[inside] - segment.start_s)
            tools[inside] = indenters.index(segment.indenter)
        return modes, targets, tools

    def longest_step(self, first: int, count: int) -> int:
        """Return the most grid steps that may be taken at once from ``first`` on, among ``count``.

        Tones above ``SLOW_HZ`` move beads to and fro within a step that their net motion allows.
        """
        grid_s = 1e-6 * STEP_US
        fastest = max(
            (
                segment.fastest_hz
                for segment in self.segments
                if segment.start_s < (first + count) * grid_s and segment.end_s > first * grid_s
            ),
            default=0.0,
        )
        if fastest <= SLOW_HZ:
            return count
        return max(int(1.0 / (STEPS_PER_PERIOD * fastest * grid_s)), 1)
