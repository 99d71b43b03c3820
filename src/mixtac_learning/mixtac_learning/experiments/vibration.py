# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Vibrations in the events (paper, section IV-A).

Two signals are examined in bins of equal length: the number of events, and flow, which is the
polarity times the gradient of the logarithm of an earlier frame. Flow is summed in square cells,
and the signal is the first principal component of these sums, so the position of the contact need
not be known.

Two kinds of contact are compared. `pressed`: the vibrating body stays 0.6 mm deep in the skin; it
causes as many events on the way in as on the way out, so the event count repeats twice per
period. `tapping`: the body touches the skin for about a third of each period, which gives one
burst per period. A body that rests on the skin by its own weight leaves it as soon as its
acceleration exceeds g: at 50 Hz from an amplitude of 0.1 mm.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixtac.figures import new_axes, save_figure
from mixtac_core.events.arrays import Events
from mixtac_learning.experiments.harness import PRESET, Context, Outcome, Row, Value, experiment
from mixtac_sim.mechanics.contact import Mode
from mixtac_sim.world.effects import preset
from mixtac_sim.world.segments import Profile, Segment, Tone
from mixtac_sim.world.sensor import TactileSensor

PRESSED = 'pressed'
TAPPING = 'tapping'
DEPTH_MM = 0.6
"""Mean depth of the vibrating body in a pressed contact [mm]."""
SIZES_MM = {PRESSED: (0.05, 0.1, 0.2), TAPPING: (0.8, 1.0)}
"""Pressed: amplitudes, zero to peak; tapping: indentation depths [mm]."""
HOVER = 0.5
"""Tapping: height of the centre of the motion above the skin, in amplitudes; the rest is depth."""
SETTLED_S = 0.56
SHAKEN_S = (0.65, 1.65)
"""Time in which the vibration is examined [s]: it has faded in, and the gel has settled."""
LOWEST_HZ = 30.0
"""Lower frequencies belong to the relaxation of the gel [Hz]."""
CELL_PX = 32
"""Side of a cell in which flow is summed [px]."""
COUNT = 'count'
"""Signal: number of events."""
FLOW = 'flow'
"""Signal: polarity times the gradient of a frame, summed over events."""
BINS_US = {COUNT: 2000, FLOW: 1000}
"""Length of a bin [us]: that of the paper, and half of it where twice the tone has to fit."""
_FINER = 8
"""Zero padding: peaks are located to an eighth of the resolution."""


def shake(
    kind: str, size_mm: float, tone_hz: float, seed: int
) -> tuple[Events, NDArray[np.uint16]]:
    """Return events of a vibration of the simulated sensor [us], and a frame from before it [DN].

    Args:
        kind: `PRESSED` or `TAPPING`.
        size_mm: Amplitude, or depth of the indentation; see `SIZES_MM` [mm].
        tone_hz: Frequency [Hz].
        seed: Seed of the sensor and of the day.
    """
    middle, amplitude = DEPTH_MM, size_mm
    if kind == TAPPING:
        amplitude = size_mm / (1.0 - HOVER)
        middle = -HOVER * amplitude
    tone = Tone(amplitude, tone_hz, 0.0, 0.05)
    end = SHAKEN_S[1]
    segments = (
        Segment(0.0, 0.2, Mode.POSITION, (0.0, 0.2), (min(-0.1, middle), middle)),
        Segment(0.2, SETTLED_S, Mode.POSITION, (0.0,), (middle,)),
        Segment(SETTLED_S, end + 0.1, Mode.POSITION, (0.0,), (middle,), (tone,)),
    )
    profile = Profile(end, segments)
    sensor = TactileSensor(seed, seed, profile, preset=preset(PRESET))
    output = sensor.advance(_us(end))
    still = [f.intensity for f in output.frames if f.frame_end_us < _us(SETTLED_S)]
    return output.events, still[-1]


def _us(seconds: float) -> int:
    return round(1e6 * seconds)


def binned(
    events: Events, frame: NDArray[np.uint16], bin_us: int
) -> dict[str, NDArray[np.float64]]:
    """Return count and flow of the events in each bin of a vibration.

    Args:
        events: Sorted events; camera clock [us].
        frame: Image from before the vibration, [260, 346] [DN].
        bin_us: Length of a bin [us]; a rest shorter than a bin does not count.
    """
    start_us, end_us = _us(SHAKEN_S[0]), _us(SHAKEN_S[1])
    rows, columns = frame.shape
    wide = -(-columns // CELL_PX)
    cells, bins = wide * -(-rows // CELL_PX), (end_us - start_us) // bin_us
    inside = events.between(start_us, start_us + bins * bin_us)
    x, y = inside.x.astype(np.int64), inside.y.astype(np.int64)
    place = (inside.t - start_us) // bin_us * cells + y // CELL_PX * wide + x // CELL_PX
    slope_y, slope_x = np.gradient(np.log(np.maximum(frame.astype(np.float64), 1.0)))
    sign = np.where(inside.polarity, 1.0, -1.0)
    weights = (sign * slope_x[y, x], sign * slope_y[y, x], None)
    sums = [np.bincount(place, weight, bins * cells) for weight in weights]
    across, down, count = np.reshape(sums, (3, bins, cells))
    # An edge that moves along its gradient darkens the pixel: the sign does not matter here.
    table = np.concatenate([across, down], axis=1)
    left, strength, _ = np.linalg.svd(table - table.mean(axis=0), full_matrices=False)
    return {COUNT: count.sum(axis=1), FLOW: left[:, 0] * strength[0]}


def spectra(events: Events, frame: NDArray[np.uint16]) -> dict[str, Any]:
    """Return, per signal, `dominant_hz` and `spectrum`, one value per Hz, largest is 1."""
    signals = {bin_us: binned(events, frame, bin_us) for bin_us in set(BINS_US.values())}
    return {name: spectrum_of(signals[bin_us][name], bin_us) for name, bin_us in BINS_US.items()}


def spectrum_of(signal: NDArray[np.float64], bin_us: int) -> dict[str, Any]:
    """Return the dominant frequency of a signal and its spectrum from 0 Hz in steps of 1 Hz.

    Args:
        signal: One value per bin.
        bin_us: Length of a bin [us].
    """
    windowed = (signal - signal.mean()) * np.hanning(len(signal))
    strength = np.abs(np.fft.rfft(windowed, _FINER * len(signal)))
    hz = np.fft.rfftfreq(_FINER * len(signal), 1e-6 * bin_us)
    strength[hz < LOWEST_HZ] = 0.0
    dominant = float(hz[int(np.argmax(strength))])
    top = max(float(strength.max()), 1e-12)
    whole = np.arange(int(hz[-1]) + 1)
    nearest = np.searchsorted(hz, whole - 0.5), np.searchsorted(hz, whole + 0.5)
    values = [float(strength[a:b].max(initial=0.0)) / top for a, b in zip(*nearest, strict=True)]
    return {'dominant_hz': dominant, 'spectrum': [round(value, 3) for value in values]}


TOLERANCE_HZ = 1.0
FIRST_SEED = 7300
"""Seeds of sensors on which nothing was tuned."""
_PLACE = 'section IV-A, Fig. 3'
SIGNALS = {
    COUNT: 'number of events, 2 ms bins',
    FLOW: 'flow, 1 ms bins',
}
Found = tuple[float, dict[str, Any]]
"""Tone [Hz] and its spectra."""


@experiment
def vibration(context: Context) -> Outcome:
    """Tones of 50 to 450 Hz: frequency measured from events.

    In the paper, a resonant speaker on the skin plays tones of 50 to 250 Hz. The dominant frequency
    of the number of events in bins of 2 ms equals the tone.

    The paper states neither amplitude nor pre-load. A pressed vibration causes as many events each
    way: their number repeats at twice its frequency, which 2 ms bins alias above 125 Hz. Contact
    that is lost in part of each period (tapping) breaks the symmetry: one burst per period. Both
    are shown.

    Flow is the polarity times the gradient of an earlier frame, summed in cells of 32 pixels, first
    principal component. Its sign changes with the motion, so that twice the frequency does not
    appear.

    Tones stay 10 Hz away from 100 and 200 Hz, where lamp ripple would be mistaken for them.
    """
    sizes = context.sizes
    seeds = range(FIRST_SEED, FIRST_SEED + context.seeds)
    fast = {PRESSED: sizes.fast_tones_hz}
    spans = [
        (kind, size, tones)
        for kind, both in SIZES_MM.items()
        for size in both
        for tones in filter(None, (sizes.tones_hz, fast.get(kind)))
    ]
    cases = [(*span[:2], tone, seed) for span in spans for tone in span[2] for seed in seeds]
    found = dict(zip(cases, context.run('vibration', _shaken_spectra, cases), strict=True))
    rows: list[Row] = []
    for kind, size, tones in spans:
        by_seed = [[(tone, found[kind, size, tone, seed]) for tone in tones] for seed in seeds]
        for signal in SIGNALS if tones == sizes.tones_hz else (FLOW,):
            rows += _rows(kind, size, signal, by_seed)
    panels = {
        f'{kind}, {1e3 * SIZES_MM[kind][0]:g} um:\n{SIGNALS[signal]}': [
            (tone, result[signal])
            for (own, size, tone, _), result in found.items()
            if (own, size) == (kind, SIZES_MM[kind][0])
            and (signal == FLOW or tone in sizes.tones_hz)
        ]
        for kind, signal in ((TAPPING, COUNT), (PRESSED, COUNT), (PRESSED, FLOW))
    }
    path = _draw(context.figure('vibration'), panels)
    return Outcome(
        data=f'virtual sensor, preset {PRESET}, {context.seeds} sensors (seeds from {FIRST_SEED}),'
        f' {len(sizes.tones_hz)} tones of {sizes.tones_hz[0]:g} to {sizes.tones_hz[-1]:g} Hz and'
        f' {len(sizes.fast_tones_hz)} above, one second each',
        rows=rows,
        figures={'Spectra over the tone, mean of the sensors; dashed: reconstructed = input': path},
    )


def _shaken_spectra(*case: Any) -> dict[str, Any]:  # noqa: ANN401
    return spectra(*shake(*case))


def _rows(kind: str, size_mm: float, signal: str, by_seed: Sequence[Sequence[Found]]) -> list[Row]:
    """Return the share of tones found within 1 Hz, and the largest error."""
    tones = [tone for tone, _ in by_seed[0]]
    errors = [
        [abs(found[signal]['dominant_hz'] - tone) for tone, found in each] for each in by_seed
    ]
    shares = Value.of(float(np.mean(np.array(each) <= TOLERANCE_HZ)) for each in errors)
    span = f'{min(tones):g} to {max(tones):g} Hz'
    name = f'{kind}, {1e3 * size_mm:g} um, {SIGNALS[signal]}, {span}'
    counted = signal == COUNT and max(tones) <= 250.0
    text = f'{len(tones)} tones; within {TOLERANCE_HZ:g} Hz'
    paper = 1.0 if counted else None
    worst = Value.of(max(each) for each in errors)
    return [
        Row(f'{name}: share of tones', shares, paper, _PLACE, '', text),
        Row(f'{name}: largest error', worst, None, '', 'Hz', f'{len(tones)} tones'),
    ]


def _draw(path: Path, panels: dict[str, list[Found]]) -> Path:
    figure, axes = new_axes(columns=len(panels), width=3.6 * len(panels), height=4.0)
    for ax, (title, found) in zip(axes, panels.items(), strict=True):
        tones = np.array(sorted({tone for tone, _ in found}))
        columns = [
            np.mean([each['spectrum'] for tone, each in found if tone == chosen], axis=0)
            for chosen in tones
        ]
        heights = np.arange(30, len(columns[0]))
        mesh = ax.pcolormesh(
            tones, heights, np.array(columns).T[30:], cmap='magma', vmin=0.0, vmax=1.0
        )
        ax.plot(tones, tones, '--', color='#56b4e9', lw=1.0)
        ax.set(xlabel='tone [Hz]')
        ax.set_title(f'{title}\nsimulated', fontsize=9)
    axes[0].set_ylabel('reconstructed [Hz]')
    figure.colorbar(mesh, ax=axes, label='amplitude / largest', fraction=0.03)
    return save_figure(figure, path)
