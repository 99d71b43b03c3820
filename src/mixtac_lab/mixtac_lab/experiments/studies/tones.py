# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Which tones the events of a simulated sensor show, and how clearly.

Three signals are examined in bins of equal length: the number of events, ON minus OFF events, and
flow, which is the polarity times the gradient of the logarithm of an earlier frame. Flow is
summed in square cells, and the first principal component of these sums is taken, so the position
of the contact need not be known.
"""

from __future__ import annotations

import json as json_module
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Optional

import numpy as np
import typer
from rich.console import Console
from rich.progress import track
from rich.table import Table

from mixtac_sim import SimulationError
from mixtac_sim.grids import HEIGHT, WIDTH
from mixtac_sim.mechanics.contact import Mode
from mixtac_sim.world.profiles import Profile, Segment, Tone
from mixtac_sim.world.sensor import TactileSensor

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_events.arrays import Events
    from mixtac_sim.world.effects import Preset


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


OptionalPath = Optional[Path]  # noqa: UP045  (typer evaluates this under Python 3.10)
FREQUENCIES = (60, 110, 160, 210, 250, 330, 430)
"""Tones [Hz], most of them away from the lines of a lamp at 100 Hz."""
AMPLITUDES = (0.02, 0.05, 0.1)
"""Amplitudes, zero to peak [mm]."""


def tones(
    preset: Annotated[str, typer.Option(help='easy, paper_like or hard.')] = 'paper_like',
    devices: Annotated[int, typer.Option(min=1, help='Number of sensors.')] = 3,
    seed: Annotated[int, typer.Option(min=0, help='Which sensors and days.')] = 11,
    json: Annotated[OptionalPath, typer.Option(help='Write the figures there as well.')] = None,
) -> None:
    """Show which vibrations stand out in the events, in bins of 1 ms."""
    from mixtac_sim.world.effects import preset as preset_of

    chosen = preset_of(preset)
    cases = [(f, a) for a in AMPLITUDES for f in FREQUENCIES]
    rows = [
        [shake(seed + k, seed, f, a, preset=chosen) for k in range(devices)]
        for f, a in track(cases, 'shaking', transient=True)
    ]
    table = Table(
        title=f'vibration, {preset}, simulated: mean over {devices} sensors', title_justify='left'
    )
    for heading in (r'peak \[um]', 'tone [Hz]', 'events above rest [1/s]', *SIGNALS):
        table.add_column(heading, justify='right')
    for row in rows:
        table.add_row(*_cells(row))
    Console().print(table)
    Console().print('line over median; in brackets on how many sensors it is the largest peak')
    if json is not None:
        content = {'preset': preset, 'devices': devices, 'seed': seed, 'rows': _content(rows)}
        json.write_text(json_module.dumps(content, indent=2) + '\n', encoding='utf-8')


SIGNALS = ('count', 'ON - OFF', 'flow')
"""Headings of the signals."""


def _signals_of(shaken: Shaken) -> tuple[Line, Line, Line]:
    return shaken.count, shaken.polarity, shaken.flow


def _cells(row: list[Shaken]) -> list[str]:
    one, many = row[0], len(row)
    above = sum(each.rate - each.rest_rate for each in row) / many
    cells = [f'{1e3 * one.amplitude_mm:.0f}', f'{one.frequency_hz:.0f}', f'{above:.0f}']
    for lines in zip(*map(_signals_of, row), strict=True):
        strength = sum(max(line.drive, line.twice) for line in lines) / many
        cells.append(f'{strength:.0f} ({sum(line.clear for line in lines)})')
    return cells


def _content(rows: list[list[Shaken]]) -> list[dict[str, object]]:
    from dataclasses import asdict

    return [asdict(each) for row in rows for each in row]
