# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Gestures: segments of presses, oscillations, drops, vibrations, pulls, slides, turns and knocks.

Each takes a random stream, a start and a span [s]. Forces are the paper's, 0 to 1 N.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.random import Generator

from mixtac_sim.mechanics.contact import GRAVITY, Mode
from mixtac_sim.mechanics.elastomer import WEIGHT_20_G
from mixtac_sim.world.segments import FREE, Pulled, Segment, Tone

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
    top, end = start_s + rise, start_s + span_s - rest
    press = Segment(start_s, top, Mode.FORCE, (0.0, rise), (0.0, force))
    hold = _hold(rng, top, end - fall, force)
    release = Segment(end - fall, end, Mode.FORCE, (0.0, fall), (force, 0.0))
    return [press, hold, release]


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
    top, end = start_s + rise, start_s + span_s - REST_S
    hold = _hold(rng, top, end - fall, force)
    back, unroll = (-move[0], -move[1], -move[2]), (-roll[0], -roll[1])
    return [
        Segment(start_s, top, Mode.FORCE, (0.0, rise), (0.0, force)),
        replace(hold, move=move, roll=roll),
        Segment(end - fall, end, Mode.FORCE, (0.0, fall), (force, 0.0)),
        Segment(end, end + 0.3, Mode.FREE, move=back, roll=unroll),
    ]


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
    """Return a weight of 100 g that a mass on a thread pulls aside in four directions."""
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
        low, high = KNOCK_MM_S
        speed = low * (high / low) ** rng.random()
        length = max(float(np.hypot(*move)) / speed, 2e-3)
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
    top, end = start_s + rise, start_s + 0.95 * span_s
    press = Segment(start_s, top, Mode.FORCE, (0.0, rise), (0.0, force))
    release = Segment(end - fall, end, Mode.FORCE, (0.0, fall), (force, 0.0))
    return [press, _hold(rng, top, end - fall, force), release]


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
    low, high = VIBRATION_MM
    tone = Tone(low * (high / low) ** rng.random(), rng.uniform(*VIBRATION_HZ), 0.0, 0.05)
    rise = min(0.3, 0.1 * span_s)
    top, end = start_s + rise, start_s + 0.9 * span_s
    return [
        Segment(start_s, top, Mode.POSITION, (0.0, rise), (-0.1, depth)),
        Segment(top, end - rise, Mode.POSITION, (0.0,), (depth,), (tone,)),
        Segment(end - rise, end, Mode.POSITION, (0.0, rise), (depth, -0.3)),
    ]


def _hold(rng: Generator, start_s: float, end_s: float, force_n: float) -> Segment:
    """Return a hold of the force or, as often, of the position, in which the force relaxes."""
    if rng.random() < 0.5:
        return Segment(start_s, end_s, Mode.HOLD)
    return Segment(start_s, end_s, Mode.FORCE, (0.0,), (force_n,), tremor(rng, force_n))
