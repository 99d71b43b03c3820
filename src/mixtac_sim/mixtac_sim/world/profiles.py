# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Contact profiles: gestures strung together under a name, randomised by seed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from numpy.random import Generator

from mixtac_sim import SimulationError
from mixtac_sim.grids import stream
from mixtac_sim.mechanics.elastomer import HEMISPHERE, INDENTERS, Indenter
from mixtac_sim.world.effects import EASY, Preset
from mixtac_sim.world.gestures import (
    SYNC_SPAN_S,
    drop,
    handling,
    knocks,
    long_hold,
    oscillation,
    press_and_hold,
    pulls,
    roll,
    shear,
    slide,
    staircase,
    sync_impulse,
    torsion,
    touch,
    vibration,
    wander,
    weights,
)
from mixtac_sim.world.segments import Profile, Segment

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
            hold), ``vibration`` (50 to 250 Hz), ``weights`` (20, 50 and 100 g in turn),
            ``pulls`` (100 g, pulled aside by 20 g in four directions; give it 24 s),
            ``touch``, ``shear``, ``slide``, ``torsion``, ``roll`` (presses with a long rest after
            each, that are held still, pulled sideways with and without a slide, turned about the
            normal or rolled), ``handling`` (all of these without a rest), ``knocks`` (presses that
            are knocked sideways) or ``demo`` (a bit of every normal force).
        seed: Fixes every random choice.
        duration_s: Length [s]; at least 10 for ``demo``.
        sync: Start and end with a synchronising impulse; by default only ``demo`` does.
        preset: Difficulty: the indenters, and whether ``static`` has steps.

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
    names = preset.contact.indenters
    tool = INDENTERS[names[int(stream(seed, 'indenter').integers(len(names)))]]
    if not synced:
        return Profile(name, duration_s, _with(tool, body))
    first, first_s = sync_impulse(rng, 0.0)
    last, last_s = sync_impulse(rng, duration_s - SYNC_SPAN_S)
    return Profile(name, duration_s, _with(tool, first + body + last), (first_s, last_s))


def _with(tool: Indenter, segments: list[Segment]) -> tuple[Segment, ...]:
    """Return segments in which another indenter replaces the hemisphere; weights stay."""
    if tool is HEMISPHERE:
        return tuple(segments)
    return tuple(
        replace(segment, indenter=tool) if segment.indenter is HEMISPHERE else segment
        for segment in segments
    )


Body = Callable[[Generator, float, float], list[Segment]]
"""Makes segments from a random stream, a start and a span [s]."""


def _repeated(gesture: Body, shortest: float, longest: float) -> Body:
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


PROFILES: dict[str, Body] = {
    'idle': lambda _rng, _start_s, _span_s: [],
    'press': _repeated(press_and_hold, 1.5, 4.0),
    'oscillation': _repeated(oscillation, 3.0, 6.0),
    'impact': _repeated(drop, 2.0, 3.5),
    'dynamic': _dynamic,
    'static': long_hold,
    'long_term': long_hold,
    'vibration': _repeated(vibration, 2.0, 4.0),
    'weights': weights,
    'pulls': pulls,
    'touch': _repeated(touch, 2.6, 3.4),
    'shear': _repeated(shear, 2.6, 3.4),
    'slide': _repeated(slide, 2.6, 3.4),
    'torsion': _repeated(torsion, 2.6, 3.4),
    'roll': _repeated(roll, 2.6, 3.4),
    'handling': _repeated(handling, 2.5, 5.0),
    'knocks': _repeated(knocks, 2.0, 4.0),
    'demo': _demo,
}
"""Bodies of the profiles by name: (random stream, start [s], span [s]) -> segments."""
