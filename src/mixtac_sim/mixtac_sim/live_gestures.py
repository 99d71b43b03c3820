# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Gestures that a user asks the live sensor for: press, put down, drop, vibrate, follow, release.

Each is a profile of its own, to be played from the moment it is asked for.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

from mixtac_sim.contact import Mode
from mixtac_sim.errors import SimulationError
from mixtac_sim.segments import Profile, Segment, Tone

if TYPE_CHECKING:
    from mixtac_sim.indenter import Indenter

RAMP_S: Final = 0.2
"""How long an object takes to come and go [s]."""
FOLLOW_RAMP_S: Final = 0.01
"""How long a commanded force takes to be reached [s]."""
FOLLOW_TIMEOUT_S: Final = 0.25
"""How long a commanded force holds without a new one [s]."""
APART_MM: Final = 0.3
"""How far a vibrating object comes and goes from the skin [mm]."""
GRAVITY: Final = 9.81


def press(tool: Indenter, force_n: float, hold_s: float) -> Profile:
    """Return a press with a force [N] that is held for some time [s]."""
    down, up = RAMP_S, RAMP_S + hold_s
    ramps = (
        Segment(0.0, down, Mode.FORCE, (0.0, RAMP_S), (0.0, force_n), indenter=tool),
        Segment(down, up, Mode.FORCE, (0.0,), (force_n,), indenter=tool),
        Segment(up, up + RAMP_S, Mode.FORCE, (0.0, RAMP_S), (force_n, 0.0), indenter=tool),
    )
    return Profile('press', up + RAMP_S, ramps)


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
        hold_s: How long [s].

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
    """Return a force [N] that is reached from another at once and fades if no new one comes."""
    first, last = FOLLOW_RAMP_S, FOLLOW_RAMP_S + FOLLOW_TIMEOUT_S
    segments = (
        Segment(0.0, first, Mode.FORCE, (0.0, FOLLOW_RAMP_S), (from_n, force_n), indenter=tool),
        Segment(first, last, Mode.FORCE, (0.0,), (force_n,), indenter=tool),
        Segment(last, last + RAMP_S, Mode.FORCE, (0.0, RAMP_S), (force_n, 0.0), indenter=tool),
    )
    return Profile('follow', last + RAMP_S, segments)


def release(tool: Indenter, from_n: float) -> Profile:
    """Return the way from a force [N] to none."""
    way = Segment(0.0, RAMP_S, Mode.FORCE, (0.0, RAMP_S), (from_n, 0.0), indenter=tool)
    return Profile('release', RAMP_S, (way,) if from_n > 0.0 else ())
