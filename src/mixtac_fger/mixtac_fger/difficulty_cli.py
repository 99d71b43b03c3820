# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The commands `experiments difficulty` and `experiments ablation`; torch is imported late."""

from __future__ import annotations

import json as json_module
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Optional

import typer
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from mixtac_fger.model_files import DEFAULT_MODEL, find_model
from mixtac_fger.trial_plan import calibration_plan, evaluation_plan, unseen_devices

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from mixtac_fger.event_integrator import Increments
    from mixtac_fger.trial_plan import TrialSpec
    from mixtac_fger.weights import LoadedModel

OptionalPath = Optional[Path]  # noqa: UP045  (typer evaluates this under Python 3.10)
Model = Annotated[str, typer.Option(help='Weight file, or name of a shipped one.')]
Preset = Annotated[str, typer.Option(help='easy, paper_like or hard.')]
Devices = Annotated[int, typer.Option(min=1, help='Number of unseen sensors.')]
Seconds = Annotated[float, typer.Option(min=6, help='Length of a trial.')]
Seed = Annotated[int, typer.Option(min=3, help='Which fresh sensors and days.')]
LESSONS = 4
"""Trials of a sensor that its event integrator is fitted to."""
LESSON = 50
"""Their trial seeds begin so far behind that of the trial that is judged."""
Json = Annotated[OptionalPath, typer.Option(help='Write the figures there as well.')]


def difficulty(
    preset: Preset = 'paper_like',
    model: Model = DEFAULT_MODEL,
    devices: Devices = 4,
    seconds: Seconds = 20.0,
    seed: Seed = 3,
    json: Json = None,
) -> None:
    """Show what frames alone, events alone, brightness and event counts tell of the force."""
    specs, presses = _plans(preset, devices, seconds, seed)
    with Progress(transient=True) as progress:
        total = len(specs) * (2 + LESSONS) + len(presses)
        bar = progress.add_task('judging', total=total)
        loaded = _load(model)
        figures = _judge_all(loaded, specs, presses, lambda: progress.advance(bar))
        kept = loaded.config.reference_frames
        figures |= _integrate_all(kept, specs, lambda: progress.advance(bar))
    table = Table(title=f'dynamic, {preset}, simulated', title_justify='left')
    table.add_column('figure')
    table.add_column('value', justify='right')
    for name, value in figures.items():
        table.add_row(name.replace('_', ' '), f'{value:.4g}')
    Console().print(table)
    _write(json, {'preset': preset, 'model': str(find_model(model)), **figures})


def ablation(
    preset: Preset = 'paper_like',
    model: Model = DEFAULT_MODEL,
    devices: Devices = 4,
    seconds: Seconds = 12.0,
    seed: Seed = 3,
    json: Json = None,
) -> None:
    """Show how the error changes when one effect of the simulated sensor is switched off."""
    from mixtac_sim.presets import EFFECTS

    specs, presses = _plans(preset, devices, seconds, seed)
    names = ['', *EFFECTS]
    rows = {}
    with Progress(transient=True) as progress:
        bar = progress.add_task('judging', total=(len(specs) + len(presses)) * len(names))
        loaded = _load(model)
        for name in names:
            dynamic, press = (
                [replace(spec, without=name) for spec in part] for part in (specs, presses)
            )
            rows[name or 'all effects'] = _judge_all(
                loaded, dynamic, press, lambda: progress.advance(bar)
            )
    whole = rows['all effects']['fused_mae']
    table = Table(title=f'dynamic, {preset}, simulated: one effect off', title_justify='left')
    for heading in ('off', 'MAE [N]', 'share of the error', 'frames only [N]'):
        table.add_column(heading, justify='left' if heading == 'off' else 'right')
    for name, row in rows.items():
        share = 1.0 - row['fused_mae'] / whole
        table.add_row(
            name, f'{row["fused_mae"]:.4f}', f'{share:+.1%}', f'{row["frames_only_mae"]:.4f}'
        )
    Console().print(table)
    _write(json, {'preset': preset, 'model': str(find_model(model)), 'rows': rows})


def _plans(
    preset: str, devices: int, seconds: float, seed: int
) -> tuple[list[TrialSpec], list[TrialSpec]]:
    seeds = unseen_devices(devices, seed)
    specs = evaluation_plan(seeds, seconds, seed, ('dynamic',), preset)
    return specs, calibration_plan(seeds, 8.0, seed, preset)


def _load(model: str) -> LoadedModel:
    from mixtac_fger.weights import load_model

    return load_model(find_model(model))


def _judge_all(
    model: LoadedModel,
    specs: Sequence[TrialSpec],
    presses: Sequence[TrialSpec],
    advance: Callable[[], None],
) -> dict[str, float]:
    from mixtac_fger.dataset import true_force
    from mixtac_fger.difficulty import Scales, judge, summarise
    from mixtac_fger.evaluation import stream
    from mixtac_fger.generation import simulate

    scales = {}
    for spec in presses:
        trial = simulate(spec)
        scales[spec.device_seed] = Scales.fit(stream(model, trial, true_force(trial.truth)))
        advance()
    judged = []
    for spec in specs:
        judged.append(judge(model, simulate(spec), scales[spec.device_seed]))
        advance()
    return summarise(judged)


def _integrate_all(
    reference_frames: int, specs: Sequence[TrialSpec], advance: Callable[[], None]
) -> dict[str, float]:
    """Return the figures of an event integrator of each sensor, fitted to other trials of it."""
    import numpy as np

    from mixtac_fger.dataset import true_force
    from mixtac_fger.event_integrator import (
        EventIntegrator,
        increments,
        judge_integrator,
        summarise_integrator,
    )
    from mixtac_fger.generation import simulate

    def windows(spec: TrialSpec) -> Increments:
        trial = simulate(spec)
        advance()
        return increments(trial, true_force(trial.truth), reference_frames)

    rows, fits = [], []
    for spec in specs:
        days = [replace(spec, trial_seed=spec.trial_seed + LESSON + k) for k in range(LESSONS)]
        integrator = EventIntegrator.choose([windows(day) for day in days])
        quarters, r2 = judge_integrator(integrator, [windows(spec)])
        rows.append(quarters)
        fits.append(r2)
    return summarise_integrator(np.concatenate(rows), float(np.mean(fits)))


def _write(path: Path | None, content: dict[str, object]) -> None:
    if path is not None:
        path.write_text(json_module.dumps(content, indent=2) + '\n', encoding='utf-8')
