# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What `mixtac train` does: progress on the terminal, then figures on fresh simulated sensors."""

from __future__ import annotations

import hashlib
import json as json_module
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from rich.console import Console
from rich.progress import Progress, track

from mixtac_fger.judge.estimators import PaperEstimator, StreamingEstimator
from mixtac_fger.judge.judging import judge_sources, sensor_scales
from mixtac_fger.judge.summary import by_profile
from mixtac_fger.judge.tables import show_figures, show_skipped
from mixtac_fger.train.parallel import Processes
from mixtac_fger.train.run_config import OURS
from mixtac_fger.train.runner import Run, Trained, loaded, save
from mixtac_fger.trial_plan import calibration_plan, evaluation_plan, unseen_devices
from mixtac_fger.trials.simulated_source import SimulatedSource

if TYPE_CHECKING:
    from mixtac_fger.judge.trial_estimate import TrialEstimator
    from mixtac_fger.train.run_config import RunConfig
    from mixtac_fger.trial_plan import TrialSpec

EVALUATION_SECONDS = 10.0
_PREPARING = 'preparing'


def run_training(config: RunConfig, folder: Path | None, jobs: int, json: Path | None) -> None:
    """Carry out a run with a progress bar, judge the model, write it.

    Args:
        config: The run.
        folder: Checkpoint and curves; None for one below `runs` that is named after the settings,
            so that the same command goes on where it was cut off.
        jobs: Processes that prepare samples.
        json: Write the figures there as well; None for nowhere.

    Raises:
        MixtacError: As `Run.carry_out`.
    """
    processes = Processes.join()
    console = Console(quiet=not processes.leads)
    # Small networks: more threads wait for each other longer than they help.
    torch.set_num_threads(1)
    try:
        trained = _train(console, config, folder or default_folder(config), jobs, processes)
        if processes.leads:
            _finish(console, config, trained, json)
    finally:
        processes.leave()


def default_folder(config: RunConfig) -> Path:
    """Return the folder of a run that is given none."""
    digest = hashlib.blake2b(config.fingerprint().encode(), digest_size=4).hexdigest()
    return Path('runs') / f'train_{config.model}_{digest}'


def _train(
    console: Console, config: RunConfig, folder: Path, jobs: int, processes: Processes
) -> Trained:
    with Progress(console=console) as progress:
        bars: dict[str, Any] = {}

        def prepared(done: int, total: int) -> None:
            if _PREPARING not in bars:
                bars[_PREPARING] = progress.add_task(_PREPARING, total=total)
            progress.update(bars[_PREPARING], completed=done)

        def report(stage: str, epoch: int, epochs: int, loss: float, error: float | None) -> None:
            if stage not in bars:
                bars[stage] = progress.add_task(stage, total=epochs)
            checked = '' if error is None else f', validation {error:.4f} N'
            text = f'{stage}, loss {loss:.5f} N{checked}'
            progress.update(bars[stage], completed=epoch, description=text)

        trained = Run(config, folder, jobs, report, prepared, processes).carry_out()
    show_skipped(console, trained.skipped)
    return trained


def _finish(console: Console, config: RunConfig, trained: Trained, json: Path | None) -> None:
    metrics = judge_trained(config, trained)
    for title, figures in metrics.items():
        show_figures(console, title.replace('_', ' '), figures)
    out = Path(config.out)
    save(out, trained, metrics)
    console.print(f'wrote {out}')
    if json is not None:
        content = {
            'model': str(out),
            'run': asdict(config),
            'training': trained.card.training,
            'metrics': metrics,
        }
        json.write_text(json_module.dumps(content, indent=2) + '\n', encoding='utf-8')


def judge_trained(config: RunConfig, trained: Trained) -> dict[str, Any]:
    """Return the figures of a model that was trained on simulated trials.

    Returns:
        Figures by profile, of fresh days of sensors that were trained on and of sensors that were
        not; nothing for bags, whose test trials `mixtac evaluate` judges.
    """
    data = config.data.simulated
    if data is None or config.judged < 1:
        return {}
    first = trained.card.training['device_seeds'][0]
    count = min(data.sensors, data.trials)
    most = -(-config.judged // 2)
    seen = list(range(first, first + count, max(count // most, 1)))[:most]
    estimator = estimator_of(trained)
    return {
        'seen_devices': judge_devices(estimator, seen, EVALUATION_SECONDS, 0, data.preset),
        'unseen_devices': judge_devices(
            estimator, unseen_devices(config.judged, 0), EVALUATION_SECONDS, 1, data.preset
        ),
    }


def estimator_of(trained: Trained) -> TrialEstimator:
    """Return a run's network as an estimator."""
    if trained.card.training['model'] == OURS:
        return StreamingEstimator(loaded(trained))
    return PaperEstimator(trained.network)


def judge_devices(
    estimator: TrialEstimator, devices: list[int], seconds: float, seed: int, preset: str
) -> dict[str, Any]:
    """Return figures by profile on simulated sensors, raw and with one gain from one press.

    Args:
        estimator: The model.
        devices: Seeds of the sensors.
        seconds: Length of a trial.
        seed: Which days.
        preset: How hard.
    """
    presses = _sources(calibration_plan(devices, seconds, seed, preset), 'calibrating')
    scales = sensor_scales(estimator, presses)
    trials = _sources(evaluation_plan(devices, seconds, seed, preset=preset), 'judging')
    return by_profile(judge_sources(estimator, trials).estimates, scales)


def _sources(specs: list[TrialSpec], title: str) -> Any:  # noqa: ANN401 - rich's own type
    return track([SimulatedSource(spec) for spec in specs], title, transient=True)
