# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Named contact profiles, randomised by seed."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from mixtac_sim.errors import SimulationError
from mixtac_sim.gestures import (
    SYNC_SPAN_S,
    drop,
    long_hold,
    oscillation,
    press_and_hold,
    staircase,
    sync_impulse,
    vibration,
    wander,
)
from mixtac_sim.indenter import HEMISPHERE, INDENTERS
from mixtac_sim.presets import EASY
from mixtac_sim.random_streams import stream
from mixtac_sim.segments import Profile, Segment

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.random import Generator

    from mixtac_sim.indenter import Indenter
    from mixtac_sim.presets import Preset

DEMO_MINIMUM_S = 10.0
"""Shortest demo [s]."""


def make_profile(
    name: str,
    seed: int,
    duration_s: float,
    *,
    sync: bool | None = None,
    preset: Preset = EASY,
) -> Profile:
    """Return a profile: the same for the same arguments.

    Args:
        name: ``idle``, ``press`` (press and hold), ``oscillation`` (2-5 Hz), ``impact`` (20 g from
            5 cm, bounces, hold), ``dynamic`` (all paces between 0 and 1 N), ``static`` (steps
            and ramps between 0 and 1 N; one long hold at ``easy``), ``long_term`` (one long
            hold), ``vibration`` (50 to 250 Hz) or ``demo`` (a bit of everything).
        seed: Fixes every random choice.
        duration_s: Length [s]; at least 10 for ``demo``.
        sync: Begin and end with a synchronising impulse; by default only ``demo`` does.
        preset: How hard the sensor is: what presses, and whether ``static`` has steps.

    Raises:
        SimulationError: Unknown name, or a duration too short for what is asked.
    """
    if name not in PROFILES:
        msg = f'profile {name!r} is unknown; choose one of {", ".join(sorted(PROFILES))}'
        raise SimulationError(msg)
    synced = name == 'demo' if sync is None else sync
    shortest = DEMO_MINIMUM_S if name == 'demo' else 0.5 + 2.0 * SYNC_SPAN_S * synced
    if duration_s < shortest:
        msg = f'profile {name!r} of {duration_s} s is too short; give at least {shortest} s'
        raise SimulationError(msg)
    rng = stream(seed, f'profile {name}')
    margin = SYNC_SPAN_S if synced else 0.0
    steps = name == 'static' and preset.contact.staircase
    make_body = staircase if steps else PROFILES[name]
    body = make_body(rng, margin, duration_s - 2.0 * margin)
    tool = _draw_indenter(seed, preset)
    if not synced:
        return Profile(name, duration_s, _with(tool, body))
    first, first_s = sync_impulse(rng, 0.0)
    last, last_s = sync_impulse(rng, duration_s - SYNC_SPAN_S)
    return Profile(name, duration_s, _with(tool, first + body + last), (first_s, last_s))


def _draw_indenter(seed: int, preset: Preset) -> Indenter:
    """Return what presses in a trial."""
    names = preset.contact.indenters
    return INDENTERS[names[int(stream(seed, 'indenter').integers(len(names)))]]


def _with(tool: Indenter, segments: list[Segment]) -> tuple[Segment, ...]:
    """Return segments with another indenter in place of the hemisphere; weights stay."""
    if tool is HEMISPHERE:
        return tuple(segments)
    return tuple(
        replace(segment, indenter=tool) if segment.indenter is HEMISPHERE else segment
        for segment in segments
    )


def _idle(_rng: Generator, _start_s: float, _span_s: float) -> list[Segment]:
    return []


def _repeated(
    gesture: Callable[[Generator, float, float], list[Segment]], shortest: float, longest: float
) -> Callable[[Generator, float, float], list[Segment]]:
    """Return a body that repeats a gesture, each time with a new length."""

    def body(rng: Generator, start_s: float, span_s: float) -> list[Segment]:
        segments: list[Segment] = []
        now, end = start_s + min(0.3, 0.1 * span_s), start_s + span_s
        while end - now > 0.3:
            length = min(rng.uniform(shortest, longest), end - now)
            segments += gesture(rng, now, length)
            now += length
        return segments

    return body


def _dynamic(rng: Generator, start_s: float, span_s: float) -> list[Segment]:
    """Mix wandering, swinging and pressing."""
    gestures = (wander, wander, oscillation, press_and_hold)

    def any_gesture(rng: Generator, start_s: float, span_s: float) -> list[Segment]:
        chosen = gestures[int(rng.integers(len(gestures)))] if span_s > 1.2 else press_and_hold
        return chosen(rng, start_s, span_s)

    return _repeated(any_gesture, 2.0, 5.0)(rng, start_s, span_s)


def _demo(rng: Generator, start_s: float, span_s: float) -> list[Segment]:
    """Return quiet, press and hold, oscillation, drop with hold, quiet."""
    shares = (('quiet', 0.06), ('press', 0.28), ('swing', 0.3), ('drop', 0.32), ('quiet', 0.04))
    gestures = {'press': press_and_hold, 'swing': oscillation, 'drop': drop}
    segments: list[Segment] = []
    now = start_s
    for kind, share in shares:
        if kind in gestures:
            segments += gestures[kind](rng, now, share * span_s)
        now += share * span_s
    return segments


PROFILES: dict[str, Callable[[Generator, float, float], list[Segment]]] = {
    'idle': _idle,
    'press': _repeated(press_and_hold, 1.5, 4.0),
    'oscillation': _repeated(oscillation, 3.0, 6.0),
    'impact': _repeated(drop, 2.0, 3.5),
    'dynamic': _dynamic,
    'static': long_hold,
    'long_term': long_hold,
    'vibration': _repeated(vibration, 2.0, 4.0),
    'demo': _demo,
}
"""Bodies of the profiles by name: (random stream, start [s], span [s]) -> segments."""
