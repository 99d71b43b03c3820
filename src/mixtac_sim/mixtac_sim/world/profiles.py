# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Contact profiles: gestures strung together under a name, randomised by seed.

A gesture is made from a random stream, a start and a span [s]: presses, oscillations, drops,
vibrations, pulls, slides, turns and knocks. Forces are the paper's, 0 to 1 N.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.random import Generator

from mixtac_sim import SimulationError
from mixtac_sim.grids import log_uniform, stream
from mixtac_sim.mechanics.contact import GRAVITY, Mode
from mixtac_sim.mechanics.elastomer import HEMISPHERE, INDENTERS, WEIGHT_20_G, Indenter
from mixtac_sim.world.effects import EASY, Preset
from mixtac_sim.world.segments import FREE, Profile, Pulled, Segment, Tone

DROP_HEIGHT_MM = 50.0
"""Height of the paper's drop (section 4.5)."""
VIBRATION_HZ = (50.0, 250.0)
"""Frequencies of the paper's vibrations (section 4.1) [Hz]."""
VIBRATION_MM = (0.05, 0.15)
"""Amplitudes of vibrations, zero to peak, drawn evenly in their logarithm [mm] (estimate).

The paper names a resonant speaker but neither drive nor amplitude. A foot of 20 g on a gel of
6 N/mm that is driven by 5 N moves by 0.12 mm at 250 Hz, and by more below.
"""
VIBRATION_DEPTH_MM = (0.4, 0.8)
"""Mean depth of vibrations in the skin [mm] (estimate): 0.2 to 2 N, as the weight of a small
speaker that is placed on it."""
SYNC_QUIET_S = 0.5
"""Rest before and after a synchronising impulse [s]."""
SYNC_SPAN_S = 2.0 * SYNC_QUIET_S + 0.04
"""Time that one synchronising impulse takes with its rest [s]."""


def sync_impulse(rng: Generator, start_s: float) -> tuple[list[Segment], float]:
    """Return a quick tap of 20-40 ms and 1-2 N with rest around it, and its centre [s]."""
    length = rng.uniform(0.02, 0.04)
    begin = start_s + SYNC_QUIET_S
    tap = Segment(
        begin,
        begin + length,
        Mode.FORCE,
        times_s=(0.0, 0.5 * length, length),
        values=(0.0, rng.uniform(1.0, 2.0), 0.0),
    )
    return [tap], begin + 0.5 * length


def tremor(rng: Generator, force_n: float) -> tuple[Tone, ...]:
    """Return the small fast variations of any hand or arm, about 1 % of the force."""
    return tuple(
        Tone(rng.uniform(0.002, 0.01) * force_n, rng.uniform(7.0, 23.0), rng.uniform(0.0, 6.28))
        for _ in range(2)
    )


def press_and_hold(rng: Generator, start_s: float, span_s: float) -> list[Segment]:
    """Return a press that is held and released, with a rest after it.

    Half of the presses hold the force, half hold the position, so that the force relaxes.
    """
    force = rng.uniform(0.15, 1.0)
    rise = min(rng.uniform(0.08, 0.6), 0.2 * span_s)
    fall = min(rng.uniform(0.06, 0.4), 0.15 * span_s)
    rest = span_s * rng.uniform(0.1, 0.25)
    return _press(rng, (start_s, start_s + span_s - rest), rise, fall, force)


def oscillation(rng: Generator, start_s: float, span_s: float) -> list[Segment]:
    """Return a press that swings at 2 to 5 Hz between about 0.1 N and 1 N."""
    mean = rng.uniform(0.4, 0.6)
    swing = mean * rng.uniform(0.5, 0.8)
    frequency = rng.uniform(2.0, 5.0)
    ramp = min(0.4, 0.15 * span_s)
    tones = (
        Tone(swing, frequency, 0.0, ramp),
        Tone(0.06 * swing, 2.0 * frequency, rng.uniform(0.0, 6.28), ramp),
    )
    values = (0.0, mean, mean * rng.uniform(0.9, 1.1), 0.0)
    times = (0.0, ramp, span_s - 2.0 * ramp, span_s - ramp)
    return [Segment(start_s, start_s + span_s - ramp, Mode.FORCE, times, values, tones)]


def wander(rng: Generator, start_s: float, span_s: float) -> list[Segment]:
    """Return a force that wanders between 0 and 1 N at every pace from 0.05 s to 0.6 s."""
    pauses = rng.choice([0.08, 0.15, 0.3, 0.6], size=64) * rng.uniform(0.6, 1.4, size=64)
    times = np.append(0.0, np.cumsum(pauses))
    times = times[times < span_s - 0.35]
    values = rng.uniform(0.05, 1.0, size=len(times))
    values[0] = 0.0
    times, values = np.append(times, span_s - 0.15), np.append(values, 0.0)
    tones = tremor(rng, 0.5) if rng.random() < 0.5 else ()
    end = start_s + span_s - 0.15
    return [Segment(start_s, end, Mode.FORCE, tuple(times), tuple(values), tones)]


def drop(rng: Generator, start_s: float, span_s: float) -> list[Segment]:
    """Return a 20 g weight that falls 5 cm, bounces, rests and is lifted off."""
    lift = min(rng.uniform(0.15, 0.3), 0.2 * span_s)
    end = start_s + span_s - min(0.2, 0.1 * span_s)
    height = DROP_HEIGHT_MM * rng.uniform(0.97, 1.03)
    pull = 1.3e-3 * WEIGHT_20_G.mass_g * 9.81
    fall = Segment(start_s, end - lift, Mode.DROP, (0.0,), (height,), (), WEIGHT_20_G)
    raised = Segment(end - lift, end, Mode.LIFT, (0.0, lift), (0.0, pull), (), WEIGHT_20_G)
    return [fall, raised]


WEIGHTS_G = (20.0, 50.0, 100.0)
"""Masses of the profile `weights` [g]."""


def weights(rng: Generator, start_s: float, span_s: float) -> list[Segment]:
    """Return weights that are put on by hand in turn, held in place, and taken off."""
    segments: list[Segment] = []
    turn = 0.3 * span_s
    for index, grams in enumerate(WEIGHTS_G):
        force = 1e-3 * GRAVITY * grams
        begin = start_s + 0.08 * span_s + index * turn
        down = begin + rng.uniform(0.08, 0.2) * turn
        up, end = begin + 0.6 * turn, begin + 0.67 * turn
        segments += [
            Segment(begin, down, Mode.FORCE, (0.0, down - begin), (0.0, force)),
            Segment(down, up, Mode.FORCE, (0.0,), (force,), tremor(rng, force)),
            Segment(up, end, Mode.FORCE, (0.0, end - up), (force, 0.0)),
        ]
    return segments


BASE_HZ = (8.0, 40.0)
"""Frequencies at which the base vibrates: tables, pumps, a running arm [Hz] (estimate)."""
STIFFNESS_N_PER_MM = 3.0
"""Stiffness of a usual contact: how much force the motion of the base makes [N/mm]."""
REST_S = 1.6
"""Rest after a touch that the zero is judged by [s]."""


def touch(
    rng: Generator,
    start_s: float,
    span_s: float,
    move: tuple[float, float, float] = (0, 0, 0),
    roll: tuple[float, float] = (0, 0),
) -> list[Segment]:
    """Return a press that is held, moved across the normal, and released with a rest.

    Args:
        rng: Draws force, ramps, and what is held.
        start_s: Start [s].
        span_s: Length with the rest [s]; less than 0.8 s beside the rest is no touch.
        move: Motion: right and down [mm], turn [rad]; undone in the air.
        roll: How far the contact rolls, right and down [mm]; undone in the air.
    """
    if span_s < REST_S + 0.8:
        return []
    force, rise, fall = rng.uniform(0.3, 1.0), rng.uniform(0.1, 0.3), rng.uniform(0.06, 0.2)
    end = start_s + span_s - REST_S
    press, hold, release = _press(rng, (start_s, end), rise, fall, force)
    back, unroll = (-move[0], -move[1], -move[2]), (-roll[0], -roll[1])
    away = Segment(end, end + 0.3, Mode.FREE, move=back, roll=unroll)
    return [press, replace(hold, move=move, roll=roll), release, away]


def _any_way(rng: Generator, shortest: float, longest: float) -> tuple[float, float]:
    """Return a way in any direction, right and down [mm]."""
    way, angle = rng.uniform(shortest, longest), rng.uniform(0.0, 2.0 * np.pi)
    return way * np.cos(angle), way * np.sin(angle)


def shear(rng: Generator, start_s: float, span_s: float) -> list[Segment]:
    """Return a press that is pulled sideways by 0.1 to 0.8 mm: it sticks, or slips at its rim."""
    return touch(rng, start_s, span_s, (*_any_way(rng, 0.1, 0.8), 0.0))


def slide(rng: Generator, start_s: float, span_s: float) -> list[Segment]:
    """Return a press that is pulled over the skin by 1 to 3 mm: stick, partial slip, slide."""
    return touch(rng, start_s, span_s, (*_any_way(rng, 1.0, 3.0), 0.0))


def torsion(rng: Generator, start_s: float, span_s: float) -> list[Segment]:
    """Return a press that is turned about the normal by 10 to 40 degrees, to either side."""
    angle = np.radians(rng.uniform(10.0, 40.0)) * rng.choice((-1.0, 1.0))
    return touch(rng, start_s, span_s, (0.0, 0.0, float(angle)))


def roll(rng: Generator, start_s: float, span_s: float) -> list[Segment]:
    """Return a press that rolls over the skin by 1 to 3 mm."""
    return touch(rng, start_s, span_s, roll=_any_way(rng, 1.0, 3.0))


PULLED_G = 20.0
"""Mass whose weight pulls in the profile `pulls` [g]."""
PULL_WAYS = ((1.0, 0.0), (-1.0, 0.0), (0.0, -1.0), (0.0, 1.0))
"""Its directions in turn, right and down: +x, -x, +y, -y of the contact frame."""


def pulls(rng: Generator, start_s: float, span_s: float) -> list[Segment]:
    """Return a weight of 100 g that a mass on a string pulls aside in four directions."""
    press, pull = (1e-3 * GRAVITY * grams for grams in (WEIGHTS_G[-1], PULLED_G))
    now, turn = start_s + 0.05 * span_s, 0.19 * span_s

    def held(length: float, values: tuple[float, float], pulled: Pulled = FREE) -> Segment:
        nonlocal now
        begin, now = now, now + length
        tones = tremor(rng, press) if values[0] == values[1] else ()
        return Segment(begin, now, Mode.FORCE, (0.0, length), values, tones, pull=pulled)

    segments = [held(0.3, (0.0, press)), held(0.1 * span_s, (press, press))]
    for right, down in PULL_WAYS:
        aside, ramp = (pull * right, pull * down), rng.uniform(0.15, 0.3)
        way = ((FREE[0], aside), (aside, aside), (aside, FREE[0]), FREE)
        lengths = (ramp, 0.5 * turn - ramp, ramp, 0.5 * turn - ramp)
        segments += [
            held(length, (press, press), part) for length, part in zip(lengths, way, strict=True)
        ]
    return [*segments, held(0.2, (press, 0.0))]


HANDLING_MM = 2.0
"""Farthest that `handling` moves the indenter along an axis [mm]."""


def handling(rng: Generator, start_s: float, span_s: float) -> list[Segment]:
    """Return a press whose force wanders while it is pulled, slid, turned and rolled in turn."""
    rest, now = min(0.4, 0.15 * span_s), start_s
    force, end = 0.0, start_s + span_s - rest
    segments, place, turned = [], np.zeros(4), 0.0
    while end - now > 0.0:
        length = min(rng.uniform(0.15, 0.7), end - now)
        last = end - now < 0.8
        length = end - now if last else length
        wanted = 0.0 if last else rng.uniform(0.15, 1.0)
        goal, turn = place.copy(), 0.0
        kind = int(rng.integers(6)) if force > 0.0 and not last else 5
        if kind < 3:
            goal[:2] += _any_way(rng, *((0.05, 0.4), (0.3, 1.2), (1.0, 3.0))[kind])
        if kind == 3 or (kind < 3 and rng.random() < 0.2):
            turn = rng.uniform(-0.5, 0.5) - 0.5 * turned
        if kind == 4:
            goal[2:] += _any_way(rng, 0.5, 3.0)
        move = np.clip(goal, -HANDLING_MM, HANDLING_MM) - place
        place, turned = place + move, turned + turn
        along = (float(move[0]), float(move[1]), float(turn))
        rolled = (float(move[2]), float(move[3]))
        knots, values = (0.0, length), (force, wanted)
        segments.append(
            Segment(now, now + length, Mode.FORCE, knots, values, move=along, roll=rolled)
        )
        now, force = now + length, wanted
    x, y, right, down = (-place).tolist()
    segments.append(Segment(end, end + rest, Mode.FREE, move=(x, y, -turned), roll=(right, down)))
    return segments


KNOCK_MM_S = (10.0, 120.0)
"""Mean speed of a knock sideways [mm/s]."""


def knocks(rng: Generator, start_s: float, span_s: float) -> list[Segment]:
    """Return a press whose indenter is knocked sideways again and again, as a held object is."""
    force, rise, fall = rng.uniform(0.2, 1.2), rng.uniform(0.05, 0.3), rng.uniform(0.05, 0.2)
    end = start_s + span_s - 0.4
    top, now, place = start_s + rise, start_s + rise, np.zeros(2)
    segments = [Segment(start_s, top, Mode.FORCE, (0.0, rise), (0.0, force))]
    while end - fall - now > 0.4:
        rest, way = rng.uniform(0.1, 0.35), np.array(_any_way(rng, 0.05, 1.2))
        move = np.clip(place + way, -HANDLING_MM, HANDLING_MM) - place
        length = max(float(np.hypot(*move)) / log_uniform(rng, KNOCK_MM_S), 2e-3)
        after = force if rng.random() < 0.5 else rng.uniform(0.2, 1.2)
        held = Segment(now, now + rest, Mode.FORCE, (0.0, rest), (force, after))
        knock = Segment(
            now + rest,
            now + rest + length,
            Mode.FORCE,
            (0.0,),
            (after,),
            move=(float(move[0]), float(move[1]), 0.0),
        )
        segments += [held, knock]
        now, force, place = now + rest + length, after, place + move
    last = Segment(now, end, Mode.FORCE, (0.0, end - fall - now, end - now), (force, force, 0.0))
    x, y = (-place).tolist()
    return [*segments, last, Segment(end, end + 0.4, Mode.FREE, move=(x, y, 0.0))]


def long_hold(rng: Generator, start_s: float, span_s: float) -> list[Segment]:
    """Return one slow press that is held, in force or in position, for nearly the whole span."""
    force = rng.uniform(0.1, 1.0)
    rise, fall = min(rng.uniform(0.5, 2.0), 0.2 * span_s), min(0.5, 0.1 * span_s)
    return _press(rng, (start_s, start_s + 0.95 * span_s), rise, fall, force)


def staircase(rng: Generator, start_s: float, span_s: float) -> list[Segment]:
    """Return a force that climbs from 0 to as much as 1 N and back, held on every step."""
    steps = int(rng.integers(3, 8))
    up = np.sort(rng.uniform(0.05, 1.0, steps))
    down = np.sort(rng.uniform(0.0, up[-1], steps - 1))[::-1]
    levels = np.concatenate([up, down, [0.0]])
    shares = rng.uniform(0.6, 1.4, len(levels))
    starts = 0.97 * span_s * np.append(0.0, np.cumsum(shares)) / shares.sum()
    rises = np.minimum(rng.uniform(0.1, 1.0, len(levels)), 0.5 * np.diff(starts))
    times, values = [0.0], [0.0]
    for level, begin, rise, end in zip(levels, starts, rises, starts[1:], strict=False):
        times += [float(begin + rise), float(0.999 * end)]
        values += [float(level), float(level)]
    tones = tremor(rng, 0.5 * up[-1])
    last = start_s + times[-1]
    return [Segment(start_s, last, Mode.FORCE, tuple(times), tuple(values), tones)]


def vibration(rng: Generator, start_s: float, span_s: float) -> list[Segment]:
    """Return a press whose indenter vibrates at one frequency between 50 and 250 Hz.

    Its place is commanded, as a stiff shaker would do, so the force follows from the layer.
    """
    depth = rng.uniform(*VIBRATION_DEPTH_MM)
    tone = Tone(log_uniform(rng, VIBRATION_MM), rng.uniform(*VIBRATION_HZ), 0.0, 0.05)
    rise = min(0.3, 0.1 * span_s)
    top, end = start_s + rise, start_s + 0.9 * span_s
    return [
        Segment(start_s, top, Mode.POSITION, (0.0, rise), (-0.1, depth)),
        Segment(top, end - rise, Mode.POSITION, (0.0,), (depth,), (tone,)),
        Segment(end - rise, end, Mode.POSITION, (0.0, rise), (depth, -0.3)),
    ]


def _press(
    rng: Generator, span_s: tuple[float, float], rise_s: float, fall_s: float, force_n: float
) -> list[Segment]:
    """Return a press, a hold and a release from the start to the end of a span."""
    start_s, end_s = span_s
    top, down = start_s + rise_s, end_s - fall_s
    return [
        Segment(start_s, top, Mode.FORCE, (0.0, rise_s), (0.0, force_n)),
        _hold(rng, top, down, force_n),
        Segment(down, end_s, Mode.FORCE, (0.0, fall_s), (force_n, 0.0)),
    ]


def _hold(rng: Generator, start_s: float, end_s: float, force_n: float) -> Segment:
    """Return a hold of the force or, as often, of the position, in which the force relaxes."""
    if rng.random() < 0.5:
        return Segment(start_s, end_s, Mode.HOLD)
    return Segment(start_s, end_s, Mode.FORCE, (0.0,), (force_n,), tremor(rng, force_n))


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
    base = stream(seed, 'base')
    shake_n = STIFFNESS_N_PER_MM * max(base.uniform(*preset.contact.shake_mm), 0.0)
    shake = (Tone(shake_n, log_uniform(base, BASE_HZ)),) if shake_n > 0.0 else ()
    names = preset.contact.indenters
    tool = INDENTERS[names[int(stream(seed, 'indenter').integers(len(names)))]]
    if not synced:
        return Profile(duration_s, _with(tool, shake, body))
    first, first_s = sync_impulse(rng, 0.0)
    last, last_s = sync_impulse(rng, duration_s - SYNC_SPAN_S)
    return Profile(duration_s, _with(tool, shake, first + body + last), (first_s, last_s))


def _with(tool: Indenter, shake: tuple[Tone, ...], segments: list[Segment]) -> tuple[Segment, ...]:
    """Return segments with another indenter than the hemisphere, and on a base that vibrates.

    Weights stay.
    """
    changed = []
    for each in segments:
        tones = each.tones + shake if each.mode is Mode.FORCE else each.tones
        used = tool if each.indenter is HEMISPHERE else each.indenter
        changed.append(replace(each, tones=tones, indenter=used))
    return tuple(changed)
