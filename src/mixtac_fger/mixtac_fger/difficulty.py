# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""How hard simulated trials are: what simpler estimators than FGER-Net achieve on them.

A simulator on which the mean brightness gives the force away, or on which events alone do, would
prove nothing about a network that fuses both.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mixtac_fger.calibration import fit_scale
from mixtac_fger.dataset import true_force
from mixtac_fger.evaluation import stream
from mixtac_fger.metrics import measure

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from mixtac_fger.dataset import RecordedTrial
    from mixtac_fger.evaluation import Run
    from mixtac_fger.weights import LoadedModel
    from mixtac_sim.trial import Trial


@dataclass(frozen=True, slots=True)
class Scales:
    """Gains of a sensor for both estimators, each fitted to its own estimates of one press.

    Attributes:
        fused: Of the whole network.
        frames: Of its frames-only force.
    """

    fused: float
    frames: float

    @classmethod
    def fit(cls, press: Run) -> Scales:
        """Return the scales that one calibration press gives.

        Raises:
            CalibrationError: It was no press.
        """
        fused = fit_scale(press.force, press.truth).force_scale
        return cls(fused, fit_scale(press.frames_only, press.truth).force_scale)


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """One trial, judged.

    Attributes:
        run: Estimates with all frames, scaled.
        blind: Estimates without any frame after the reference, scaled: events alone, integrated.
        brightness: Mean brightness of the latest frame over that of the first ones, held.
        counts: Events per window.
    """

    run: Run
    blind: Run
    brightness: NDArray[np.float64]
    counts: NDArray[np.float64]


def judge(model: LoadedModel, trial: Trial, scales: Scales) -> Judged:
    """Run all estimators on a trial.

    Args:
        model: Network with its weights.
        trial: A simulated trial.
        scales: Gains of its sensor.
    """
    label = true_force(trial.truth)
    kept = model.config.reference_frames
    run = stream(model, trial, label)
    blind = stream(model, trial, label, frames=kept)
    brightness = _brightness(trial, run.t_us, kept)
    cuts = np.searchsorted(trial.events.t, [run.t_us[0] - model.config.window_us, *run.t_us])
    both = type(run)(run.t_us, scales.fused * run.force, scales.frames * run.frames_only, run.truth)
    return Judged(both, blind.scaled(scales.fused), brightness, np.diff(cuts).astype(np.float64))


def _brightness(trial: RecordedTrial, t_us: NDArray[np.int64], kept: int) -> NDArray[np.float64]:
    means = trial.frames.reshape(len(trial.frames), -1).mean(axis=1)
    latest = np.searchsorted(trial.arrival_us, t_us, side='right') - 1
    return np.asarray(means[np.maximum(latest, 0)] / means[:kept].mean(), np.float64)


def summarise(judged: Sequence[Judged]) -> dict[str, float]:
    """Return the figures over trials.

    Returns:
        `fused_mae`, `frames_only_mae` [N] and their ratio; `events_only_early_mae` and
        `events_only_late_mae` [N], in the first and last quarter of the trials, and
        `events_only_drift` [N/s], the slope of the absolute error; `r2_brightness` and `r2_count`,
        what a straight line through all trials explains at best.
    """
    truth = np.concatenate([each.run.truth for each in judged])
    fused = measure(truth, np.concatenate([each.run.force for each in judged])).mae
    frames = measure(truth, np.concatenate([each.run.frames_only for each in judged])).mae
    early, late, slope = _drift([each.blind for each in judged])
    return {
        'trials': len(judged),
        'fused_mae': fused,
        'frames_only_mae': frames,
        'frames_only_over_fused': frames / fused,
        'events_only_early_mae': early,
        'events_only_late_mae': late,
        'events_only_drift': slope,
        'r2_brightness': explained(np.concatenate([each.brightness for each in judged]), truth),
        'r2_count': explained(np.concatenate([each.counts for each in judged]), truth),
    }


def _drift(runs: Sequence[Run]) -> tuple[float, float, float]:
    quarters, slopes = [], []
    for run in runs:
        error = np.abs(run.force - run.truth)
        part = len(error) // 4
        quarters.append((error[:part].mean(), error[-part:].mean()))
        slopes.append(np.polyfit((run.t_us - run.t_us[0]) / 1e6, error, 1)[0])
    early, late = np.mean(quarters, axis=0)
    return float(early), float(late), float(np.mean(slopes))


def explained(feature: NDArray[np.floating], truth: NDArray[np.floating]) -> float:
    """Return R2 of the least-squares line from a feature to the truth, fitted to the same data."""
    if np.ptp(feature) == 0.0:
        return 0.0
    return float(np.corrcoef(feature, truth)[0, 1] ** 2)
