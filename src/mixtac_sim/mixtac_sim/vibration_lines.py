# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""How clearly the frequency of a vibration stands in the events of a simulated sensor.

Three signals are looked at, each in bins of equal length: the number of events, ON less OFF events,
and flow: polarity times the gradient of the logarithm of a frame taken before, which says where
the edge under the pixel moved. Flow is summed in square cells, and of those sums the component
that varies most is taken, so nobody needs to know where the contact is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mixtac_sim.array_geometry import HEIGHT, WIDTH
from mixtac_sim.contact import Mode
from mixtac_sim.errors import SimulationError
from mixtac_sim.segments import Profile, Segment, Tone
from mixtac_sim.sensor import TactileSensor

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_events.arrays import Events
    from mixtac_sim.presets import Preset

CELL_PX = 32
"""Side of a cell in which flow is summed [px]."""
LOWEST_HZ = 30.0
"""Peaks are looked for from here on: below lies the relaxation of the gel [Hz]."""
REST_S = (0.35, 0.55)
"""When the contact holds still [s]."""
SHAKE_S = (0.65, 1.65)
"""When it vibrates [s]; fades end before."""


@dataclass(frozen=True, slots=True)
class Line:
    """The vibration in the spectrum of one signal.

    Attributes:
        drive: Amplitude at the drive over the median of all frequencies.
        twice: At twice the drive, or at its alias.
        peak_hz: Where the spectrum is largest, from 30 Hz on [Hz].
        clear: Whether that is the drive or twice it (or its alias).
    """

    drive: float
    twice: float
    peak_hz: float
    clear: bool


@dataclass(frozen=True, slots=True)
class Shaken:
    """A sensor under one vibration.

    Attributes:
        frequency_hz: Of the indenter [Hz].
        amplitude_mm: Of the indenter, zero to peak [mm].
        rest_rate: Events per second while it holds still [1/s].
        rate: While it vibrates [1/s].
        count: The line in the number of events.
        polarity: In ON less OFF events.
        flow: In gradient-signed flow.
    """

    frequency_hz: float
    amplitude_mm: float
    rest_rate: float
    rate: float
    count: Line
    polarity: Line
    flow: Line


def shake(
    device_seed: int,
    seed: int,
    frequency_hz: float,
    amplitude_mm: float,
    *,
    preset: Preset,
    depth_mm: float = 0.6,
    bin_us: int = 1000,
) -> Shaken:
    """Press a simulated sensor, let the indenter vibrate, and look for its line.

    Args:
        device_seed: Which sensor.
        seed: Which day.
        frequency_hz: Of the vibration [Hz], a whole number.
        amplitude_mm: Zero to peak [mm].
        preset: How hard the sensor is.
        depth_mm: How deep the indenter stands meanwhile [mm].
        bin_us: Length of a bin [us].

    Raises:
        SimulationError: The indenter would leave the skin, or a frame to compare with is missing.
    """
    if amplitude_mm >= depth_mm:
        msg = f'{amplitude_mm} mm at a depth of {depth_mm} mm lifts the indenter; press deeper'
        raise SimulationError(msg)
    begin = REST_S[1] + 0.01
    tone = Tone(amplitude_mm, frequency_hz, 0.0, 0.05)
    segments = (
        Segment(0.0, 0.2, Mode.POSITION, (0.0, 0.2), (-0.1, depth_mm)),
        Segment(0.2, begin, Mode.POSITION, (0.0,), (depth_mm,)),
        Segment(begin, SHAKE_S[1] + 0.1, Mode.POSITION, (0.0,), (depth_mm,), (tone,)),
    )
    profile = Profile('vibration', SHAKE_S[1], segments)
    output = TactileSensor(device_seed, seed, profile, preset=preset).advance(_us(SHAKE_S[1]))
    still = [f.intensity for f in output.frames if f.frame_end_us < _us(begin)]
    if not still:
        raise SimulationError(f'no frame before {begin} s; press for longer')
    signals = binned(output.events, still[-1], SHAKE_S, bin_us)
    rest = output.events.between(_us(REST_S[0]), _us(REST_S[1]))
    moving = output.events.between(_us(SHAKE_S[0]), _us(SHAKE_S[1]))
    return Shaken(
        frequency_hz,
        amplitude_mm,
        len(rest) / (REST_S[1] - REST_S[0]),
        len(moving) / (SHAKE_S[1] - SHAKE_S[0]),
        *(find_line(signal, frequency_hz, bin_us) for signal in signals),
    )


def binned(
    events: Events, frame: NDArray[np.integer], span_s: tuple[float, float], bin_us: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return number, ON less OFF, and flow of the events in each bin of a span.

    Args:
        events: Sorted events; times [us].
        frame: Image from before the span [260, 346] [DN].
        span_s: Begin and end [s].
        bin_us: Length of a bin [us].
    """
    first, last = _us(span_s[0]), _us(span_s[1])
    bins = (last - first) // bin_us
    inside = events.between(first, first + bins * bin_us)
    which = (inside.t - first) // bin_us
    sign = np.where(inside.polarity, 1.0, -1.0)
    counts = np.bincount(which, minlength=bins).astype(np.float64)
    balance = np.bincount(which, sign, minlength=bins).astype(np.float64)
    slopes = np.gradient(np.log(np.maximum(frame.astype(np.float64), 1.0)))
    wide = -(-WIDTH // CELL_PX)
    cells = wide * -(-HEIGHT // CELL_PX)
    cell = which * cells + (inside.y // CELL_PX).astype(np.int64) * wide + inside.x // CELL_PX
    # An edge that moves along its gradient darkens the pixel: the sign does not matter here.
    sums = [
        np.bincount(cell, sign * slope[inside.y, inside.x], minlength=bins * cells)
        for slope in slopes
    ]
    table = np.concatenate([each.reshape(bins, cells) for each in sums], axis=1)
    left, strength, _ = np.linalg.svd(table - table.mean(axis=0), full_matrices=False)
    return counts, balance, left[:, 0] * strength[0]


def find_line(signal: NDArray[np.float64], frequency_hz: float, bin_us: int) -> Line:
    """Return how a frequency stands in the spectrum of a signal.

    Args:
        signal: One value per bin; its length should hold whole periods of the frequency.
        frequency_hz: To look for [Hz].
        bin_us: Length of a bin [us].
    """
    spectrum = np.abs(np.fft.rfft(signal - signal.mean()))
    per_hz = 1e-6 * bin_us * len(signal)
    places = [_folded(times * frequency_hz * per_hz, len(signal)) for times in (1, 2)]
    lowest = int(LOWEST_HZ * per_hz)
    peak = lowest + int(np.argmax(spectrum[lowest:]))
    floor = max(float(np.median(spectrum[1:])), 1e-12)
    drive, twice = (float(spectrum[place] / floor) for place in places)
    return Line(drive, twice, peak / per_hz, min(abs(peak - place) for place in places) <= 1)


def _folded(place: float, length: int) -> int:
    """Return the place in a spectrum of real values at which a frequency appears."""
    turned = round(place) % length
    return min(turned, length - turned)


def _us(seconds: float) -> int:
    return round(1e6 * seconds)
