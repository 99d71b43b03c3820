# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The commands `train` and `evaluate`; torch is imported only once they run."""

from __future__ import annotations

import json as json_module
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

import typer
from rich.console import Console
from rich.progress import Progress, track
from rich.table import Table

from mixtac_fger.config import FgerConfig
from mixtac_fger.model_files import DEFAULT_MODEL, find_model
from mixtac_fger.trial_plan import (
    DEFAULT_PRESET,
    calibration_plan,
    evaluation_plan,
    training_plan,
    unseen_devices,
)

if TYPE_CHECKING:
    from mixtac_fger.network import FgerNetwork
    from mixtac_fger.training_settings import TrainingSettings
    from mixtac_fger.trial_plan import TrialSpec
    from mixtac_fger.weights import LoadedModel

OptionalPath = Optional[Path]  # noqa: UP045  (typer evaluates this under Python 3.10)
_EVALUATION_SECONDS = 10.0


def train(
    out: Annotated[Path, typer.Option(help='Weight file to write.')] = Path(
        'models/fger_small.safetensors'
    ),
    seed: Annotated[int, typer.Option(min=0, help='Of data, weights and order.')] = 0,
    trials: Annotated[int, typer.Option(min=1, help='Simulated trials to train on.')] = 96,
    gels: Annotated[int, typer.Option(min=1, help='Different sensors among them.')] = 96,
    seconds: Annotated[float, typer.Option(min=4, help='Length of a trial.')] = 8.0,
    epochs: Annotated[
        int, typer.Option(min=1, help='Epochs of the recurrent stage; the others in proportion.')
    ] = 60,
    preset: Annotated[str, typer.Option(help='easy, paper_like or hard.')] = DEFAULT_PRESET,
    jobs: Annotated[int, typer.Option(min=1, help='Processes that simulate.')] = 2,
    data: Annotated[Path, typer.Option(help='Where samples are kept.')] = Path('runs/fger_data'),
    json: Annotated[OptionalPath, typer.Option(help='Write the figures there as well.')] = None,
) -> None:
    """Simulate trials on many virtual sensors, train FGER-Net on them, and judge it on others."""
    from mixtac_fger.training_settings import TrainingSettings
    from mixtac_fger.weights import LoadedModel, ModelCard, save_model

    console = Console()
    settings = TrainingSettings(
        seed=seed, frame_epochs=-(-epochs // 2), recurrent_epochs=epochs, joint_epochs=epochs // 6
    )
    plan = training_plan(trials, min(gels, trials), seconds, seed, preset)
    started = time.monotonic()
    network = _fit(plan, settings, data, jobs)
    training = _provenance(plan, settings) | {
        'minutes': round((time.monotonic() - started) / 60, 1)
    }
    model = LoadedModel(network, ModelCard(training))
    seen = [plan[index].device_seed for index in range(0, len(plan), max(len(plan) // 3, 1))][:3]
    metrics = {
        'seen_devices': _judge(model, seen, _EVALUATION_SECONDS, 0, preset),
        'unseen_devices': _judge(model, unseen_devices(6, 0), _EVALUATION_SECONDS, 1, preset),
    }
    save_model(out, network, ModelCard(training, metrics))
    for title, figures in metrics.items():
        _show(console, title.replace('_', ' '), figures)
    console.print(f'wrote {out}')
    _write_json(json, {'model': str(out), 'training': training, 'metrics': metrics})


def evaluate(
    model: Annotated[str, typer.Option(help='Weight file, or name of a shipped one.')] = (
        DEFAULT_MODEL
    ),
    seed: Annotated[int, typer.Option(min=2, help='Which fresh sensors and days.')] = 2,
    gels: Annotated[int, typer.Option(min=1, help='Number of sensors.')] = 3,
    seconds: Annotated[float, typer.Option(min=4, help='Length of a trial.')] = 10.0,
    preset: Annotated[str, typer.Option(help='easy, paper_like or hard.')] = DEFAULT_PRESET,
    json: Annotated[OptionalPath, typer.Option(help='Write the figures there as well.')] = None,
) -> None:
    """Judge a model on simulated trials of sensors that no training has used."""
    from mixtac_fger.weights import load_model

    path = find_model(model)
    loaded = load_model(path)
    figures = _judge(loaded, unseen_devices(gels, seed), seconds, seed, preset)
    _show(Console(), f'{path.name} on {gels} unseen sensors', figures)
    _write_json(json, {'model': str(path), 'metrics': {'unseen_devices': figures}})


def _fit(plan: list[TrialSpec], settings: TrainingSettings, data: Path, jobs: int) -> FgerNetwork:
    """Simulate and train with a progress bar."""
    import torch

    from mixtac_fger.batches import stack
    from mixtac_fger.generation import generate
    from mixtac_fger.training import Trainer

    torch.set_num_threads(1)
    config = FgerConfig()
    with Progress() as progress:
        task = progress.add_task('simulating', total=len(plan))
        samples = []
        for sample in generate(plan, config, data, jobs):
            samples.append(sample)
            progress.advance(task)
        sequences = stack(samples)
        bars: dict[str, Any] = {}

        def report(stage: str, epoch: int, epochs: int, loss: float) -> None:
            bar = bars.setdefault(stage, progress.add_task(stage, total=epochs, visible=False))
            text = f'{stage}, loss {loss:.5f} N'
            progress.update(bar, completed=epoch, description=text, visible=True)

        return Trainer(config, settings, report).run(sequences)


def _judge(
    model: LoadedModel, devices: list[int], seconds: float, seed: int, preset: str
) -> dict[str, Any]:
    """Return figures per profile and over all, raw and with each sensor calibrated by one press."""
    from mixtac_fger.calibration import fit_scale
    from mixtac_fger.dataset import true_force
    from mixtac_fger.evaluation import Run, stream, summarise
    from mixtac_fger.generation import simulate

    def run(spec: TrialSpec) -> Run:
        trial = simulate(spec)
        return stream(model, trial, true_force(trial.truth))

    scales = {}
    for spec in track(
        calibration_plan(devices, seconds, seed, preset), 'calibrating', transient=True
    ):
        press = run(spec)
        scales[spec.device_seed] = fit_scale(press.force, press.truth).force_scale
    runs: dict[str, list[tuple[Run, float]]] = {}
    for spec in track(
        evaluation_plan(devices, seconds, seed, preset=preset), 'judging', transient=True
    ):
        runs.setdefault(spec.profile, []).append((run(spec), scales[spec.device_seed]))
    figures = {profile: summarise(found) for profile, found in runs.items()}
    return figures | {'all': summarise(pair for found in runs.values() for pair in found)}


def _provenance(plan: list[TrialSpec], settings: TrainingSettings) -> dict[str, Any]:
    from mixtac_fger.generation import simulator_digest

    devices = sorted({spec.device_seed for spec in plan})
    days = sorted(spec.trial_seed for spec in plan)
    return {
        'data': 'simulated (mixtac_sim)',
        'simulator': simulator_digest(),
        'label': 'true normal force',
        'trials': len(plan),
        'seconds': plan[0].seconds,
        'device_seeds': [devices[0], devices[-1]],
        'trial_seeds': [days[0], days[-1]],
        'preset': plan[0].preset,
        'profiles': sorted({spec.profile for spec in plan}),
        'settings': settings.to_dict(),
    }


def _show(console: Console, title: str, figures: dict[str, Any]) -> None:
    table = Table(title=title, title_justify='left')
    columns = (
        'mae',
        'rmse',
        'r2',
        'calibrated_mae',
        'frames_only_mae',
        'constant_mae',
        'peak_truth',
        'peak_estimate',
    )
    table.add_column('profile')
    for name in columns:
        table.add_column(name.replace('_', ' '), justify='right')
    for profile, row in figures.items():
        table.add_row(profile, *(f'{row[c]:.3f}' if c in row else '-' for c in columns))
    console.print(table)


def _write_json(path: Path | None, content: dict[str, Any]) -> None:
    if path is not None:
        path.write_text(json_module.dumps(content, indent=2) + '\n', encoding='utf-8')
