# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The gestures that profiles are made of: taps, presses, oscillations, wandering force, drops.

Each returns the segments of one gesture that starts at a given time and fits a given span.
Forces are those of the paper's trials, 0 to 1 N.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mixtac_sim.contact import Mode
from mixtac_sim.indenter import WEIGHT_20_G
from mixtac_sim.segments import Segment, Tone

if TYPE_CHECKING:
    from numpy.random import Generator

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
"""How deep what vibrates stands in the skin [mm] (estimate): 0.2 to 2 N, as the weight of a small
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


def press_and_hold(
    rng: Generator, start_s: float, span_s: float, force_n: float | None = None
) -> list[Segment]:
    """Return a press that is held and released, with a rest after it.

    Half of the presses hold the force, half hold the position, so that the force relaxes.
    """
    force = rng.uniform(0.15, 1.0) if force_n is None else force_n
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
