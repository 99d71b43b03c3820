# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Which vibrations the events show (paper, section IV-A)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mixtac_bringup.errors import BagError
from mixtac_bringup.experiments.figure_style import mark, new_figure, save_figure
from mixtac_bringup.experiments.rows import Outcome, Row, Value
from mixtac_bringup.experiments.shaking import PRESSED, SIZES_MM, TAPPING, tone_of
from mixtac_bringup.experiments.sizes import PRESET
from mixtac_bringup.experiments.trial_sets import is_simulated
from mixtac_bringup.experiments.vibration_spectra import (
    COUNT,
    FLOW,
    POLARITY,
    BagShakePiece,
    ShakePiece,
)
from mixtac_fger.trials.bag_source import bag_sources

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from mixtac_bringup.experiments.context import Context

TOLERANCE_HZ = 1.0
FIRST_SEED = 7300
"""Sensors that nothing was chosen on."""
_PLACE = 'section IV-A, Fig. 3'
SIGNALS = {
    COUNT: 'number of events, 2 ms bins',
    POLARITY: 'ON less OFF, 2 ms bins',
    FLOW: 'flow, 1 ms bins',
}
_PAPER = (
    'Tones of 50 to 250 Hz from a resonant speaker on the skin; number of events in bins of 2 ms,'
    ' Fourier transform; the dominant frequency equals the input.'
)
Found = tuple[float, dict[str, Any]]
"""Tone [Hz] and its spectra."""


def vibration(context: Context) -> Outcome:
    """Return how many tones are found within 1 Hz.

    Raises:
        MixtacError: A bag cannot be used.
    """
    return _simulated(context) if context.bags is None else _recorded(context, context.bags)


def _simulated(context: Context) -> Outcome:
    sizes = context.sizes
    cases = [(kind, size) for kind, both in SIZES_MM.items() for size in both]
    pieces = [
        ShakePiece(kind, tone, size, FIRST_SEED + seed)
        for kind, size in cases
        for tone in sizes.tones_hz + (sizes.fast_tones_hz if kind == PRESSED else ())
        for seed in range(context.seeds)
    ]
    results = context.run('vibration', pieces)
    pairs = list(zip(pieces, results, strict=True))
    rows: list[Row] = []
    for kind, size in cases:
        by_seed = [
            [
                (p.tone_hz, r)
                for p, r in pairs
                if (p.kind, p.size_mm, p.seed) == (kind, size, FIRST_SEED + s)
            ]
            for s in range(context.seeds)
        ]
        for signal in SIGNALS:
            rows += _rows(kind, size, signal, by_seed, sizes.tones_hz)
        if kind == PRESSED and sizes.fast_tones_hz:
            rows += _rows(kind, size, FLOW, by_seed, sizes.fast_tones_hz)
    panels = {
        f'{kind}, {1e3 * size:g} um:\n{SIGNALS[signal]}': [
            (p.tone_hz, r[signal])
            for p, r in pairs
            if (p.kind, p.size_mm) == (kind, size)
            and (signal == FLOW or p.tone_hz <= sizes.tones_hz[-1])
        ]
        for kind, signal in ((TAPPING, COUNT), (PRESSED, COUNT), (PRESSED, FLOW))
        for size in SIZES_MM[kind][:1]
    }
    path = _draw(context.figures / 'vibration.png', panels, simulated=True)
    return Outcome(
        name='vibration',
        title='Vibrations',
        paper=_PAPER,
        data=f'virtual sensor, preset {PRESET}, {context.seeds} sensors (seeds from {FIRST_SEED}),'
        f' {len(sizes.tones_hz)} tones of {sizes.tones_hz[0]:g} to {sizes.tones_hz[-1]:g} Hz and'
        f' {len(sizes.fast_tones_hz)} above, one second each',
        rows=rows,
        figures={'Spectra over the tone, mean of the sensors; dashed: reconstructed = input': path},
        deviations=(
            (
                'The paper names neither amplitude nor pre-load. Pressed in, a'
                ' vibration makes as many'
                ' events each way, and the number of events repeats at twice its'
                ' frequency, which 2 ms'
                ' bins fold back above 125 Hz. What breaks the symmetry is contact that is lost in'
                ' part of each period (tapping): one burst per period. Both are'
                ' shown. Unequal ON and'
                ' OFF thresholds break it too, but by less than the lamp ripple of this preset.'
            ),
            (
                'Flow is the polarity times the gradient of a frame from before, summed in cells of'
                ' 32 pixels, first principal component; it changes its sign with the'
                ' motion, so twice'
                ' the frequency does not appear.'
            ),
            'Tones keep 10 Hz from 100 and 200 Hz, where a lamp ripple would be taken for them.',
        ),
    )


def _recorded(context: Context, bags: Path) -> Outcome:
    folder = bags / 'vibration'
    paths = sorted(path.parent for path in folder.glob('*/metadata.yaml'))
    if not paths:
        raise BagError(
            f'{folder} holds no bags: record one bag per tone and name it after it, such as'
            ' speaker_120hz'
        )
    pieces = [BagShakePiece(path, tone_of(path.name)) for path in paths]
    results = context.run('vibration', pieces)
    found = [(piece.tone_hz, result) for piece, result in zip(pieces, results, strict=True)]
    tones = sorted({tone for tone, _ in found})
    simulated = any(is_simulated(bag) for bag in bag_sources(folder))
    kind = 'simulated bags' if simulated else 'recorded'
    rows = [row for signal in SIGNALS for row in _rows(kind, 0.0, signal, [found], tones)]
    panels = {SIGNALS[name]: [(tone, r[name]) for tone, r in found] for name in SIGNALS}
    path = _draw(context.figures / 'vibration.png', panels, simulated=simulated)
    return Outcome(
        name='vibration',
        title='Vibrations',
        paper=_PAPER,
        data=f'{len(paths)} bags in {folder.name}; tones from their names',
        rows=rows,
        figures={'Spectra over the tone; dashed: reconstructed = input': path},
    )


def _rows(
    kind: str,
    size_mm: float,
    signal: str,
    by_seed: Sequence[Sequence[Found]],
    tones: Sequence[float],
) -> list[Row]:
    """Return the share of tones that are found within 1 Hz, and the largest error."""
    errors = [
        [abs(found[signal]['dominant_hz'] - tone) for tone, found in each if tone in tones]
        for each in by_seed
    ]
    shares = Value.of(float(np.mean(np.array(each) <= TOLERANCE_HZ)) for each in errors)
    worst = Value.of(max(each) for each in errors)
    size = f', {1e3 * size_mm:g} um' if size_mm else ''
    span = f'{min(tones):g} to {max(tones):g} Hz'
    name = f'{kind}{size}, {SIGNALS[signal]}, {span}'
    counted = signal == COUNT and max(tones) <= 250.0
    simulated = kind != 'recorded'
    place = _PLACE if counted else ''
    text = f'{len(tones)} tones; within {TOLERANCE_HZ:g} Hz'
    paper = 1.0 if counted else None
    rows = [Row(f'{name}: share of tones', shares, paper, place, '', text, simulated)]
    if signal != POLARITY:
        text = f'{len(tones)} tones'
        rows.append(Row(f'{name}: largest error', worst, None, '', 'Hz', text, simulated))
    return rows


def _draw(path: Path, panels: dict[str, list[Found]], *, simulated: bool) -> Path:
    figure, axes = new_figure(columns=len(panels), width=3.6 * len(panels), height=4.0)
    for ax, (title, found) in zip(axes, panels.items(), strict=True):
        tones = np.array(sorted({tone for tone, _ in found}))
        columns = [
            np.mean([each['spectrum'] for tone, each in found if tone == chosen], axis=0)
            for chosen in tones
        ]
        highest = len(columns[0]) - 1
        # Columns are as wide as the tones lie apart.
        middles = 0.5 * (tones[1:] + tones[:-1])
        half = 0.5 * (tones[1] - tones[0]) if len(tones) > 1 else 5.0
        edges = np.concatenate([[tones[0] - half], middles, [tones[-1] + half]])
        picture = np.array(columns).T[30:]
        heights = np.arange(30, highest + 2) - 0.5
        mesh = ax.pcolormesh(edges, heights, picture, cmap='magma', vmin=0.0, vmax=1.0)
        ax.plot([30.0, highest], [30.0, highest], '--', color='#56b4e9', lw=1.0)
        ax.set(xlim=(edges[0], edges[-1]), ylim=(30.0, highest), xlabel='tone [Hz]')
        ax.set_title(f'{title}\n{mark(simulated)}', fontsize=9)
        ax.grid(visible=False)
    axes[0].set_ylabel('reconstructed [Hz]')
    figure.colorbar(mesh, ax=axes, label='amplitude / largest', fraction=0.03)
    return save_figure(figure, path)
