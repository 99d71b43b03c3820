# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The command `experiments tones`: which tones the events of a simulated sensor show."""

from __future__ import annotations

import json as json_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Optional

import typer
from rich.console import Console
from rich.progress import track
from rich.table import Table

if TYPE_CHECKING:
    from mixtac_sim.vibration_lines import Line, Shaken

OptionalPath = Optional[Path]  # noqa: UP045  (typer evaluates this under Python 3.10)
FREQUENCIES = (60, 110, 160, 210, 250, 330, 430)
"""Tones [Hz], most of them away from the lines of a lamp at 100 Hz."""
AMPLITUDES = (0.02, 0.05, 0.1)
"""Amplitudes, zero to peak [mm]."""


def vibration(
    preset: Annotated[str, typer.Option(help='easy, paper_like or hard.')] = 'paper_like',
    devices: Annotated[int, typer.Option(min=1, help='Number of sensors.')] = 3,
    seed: Annotated[int, typer.Option(min=0, help='Which sensors and days.')] = 11,
    json: Annotated[OptionalPath, typer.Option(help='Write the figures there as well.')] = None,
) -> None:
    """Show which vibrations stand out in the events, in bins of 1 ms."""
    from mixtac_sim.presets import preset as preset_of
    from mixtac_sim.vibration_lines import shake

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


def _lines(shaken: Shaken) -> tuple[Line, Line, Line]:
    return shaken.count, shaken.polarity, shaken.flow


def _cells(row: list[Shaken]) -> list[str]:
    one, many = row[0], len(row)
    above = sum(each.rate - each.rest_rate for each in row) / many
    cells = [f'{1e3 * one.amplitude_mm:.0f}', f'{one.frequency_hz:.0f}', f'{above:.0f}']
    for lines in zip(*map(_lines, row), strict=True):
        strength = sum(max(line.drive, line.twice) for line in lines) / many
        cells.append(f'{strength:.0f} ({sum(line.clear for line in lines)})')
    return cells


def _content(rows: list[list[Shaken]]) -> list[dict[str, object]]:
    from dataclasses import asdict

    return [asdict(each) for row in rows for each in row]
