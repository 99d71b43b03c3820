# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Models of both kinds, run over trials as they would run live."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mixtac_fger.errors import DatasetError
from mixtac_fger.evaluation import stream
from mixtac_fger.judge.trial_estimate import TrialEstimate, TrialEstimator
from mixtac_fger.paper.estimate import run_samples
from mixtac_fger.paper.samples import make_paper_sample
from mixtac_fger.paper.weights import ARCHITECTURE as PAPER
from mixtac_fger.paper.weights import architecture_of, load_paper_model
from mixtac_fger.weights import load_model
from mixtac_fger.windows_of_trial import window_ends

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from mixtac_fger.paper.models import PaperNetwork
    from mixtac_fger.trials.trial_arrays import TrialArrays
    from mixtac_fger.weights import LoadedModel

SETTLE_FRAMES = 5
"""Frames before the first window that counts: those of FGER-Net's reference."""


@dataclass(frozen=True, slots=True, eq=False)
class StreamingEstimator:
    """FGER-Net through the live estimator.

    Attributes:
        model: Network with its weights.
    """

    model: LoadedModel

    def estimate(self, trial: TrialArrays) -> TrialEstimate:
        """Return the estimates of a trial, from its first force on.

        Raises:
            DatasetError: There is none: too few still frames at the beginning.
        """
        run = stream(self.model, trial, trial.label())
        if not len(run.t_us):
            raise DatasetError(
                f'{trial.origin.get("name")} gives no estimate: it must begin with'
                f' {self.model.config.reference_frames} frames without contact'
            )
        return _beside(trial, run.t_us, run.force, run.frames_only, run.deviation)


@dataclass(frozen=True, slots=True, eq=False)
class PaperEstimator:
    """One of the paper's networks.

    Attributes:
        network: In evaluation mode.
        settle_frames: Frames before the first estimate that counts: as many as the reference of
            FGER-Net takes, so that all models are judged on the same windows.
    """

    network: PaperNetwork
    settle_frames: int = SETTLE_FRAMES

    def estimate(self, trial: TrialArrays) -> TrialEstimate:
        """Return the estimates of a trial.

        Raises:
            DatasetError: Its frames are too few or of another size.
        """
        sample = make_paper_sample(self.network.config, trial)
        (force,) = run_samples(self.network, [sample])
        later = sample.window_end_us > _settled_us(trial, self.settle_frames)
        return _beside(trial, sample.window_end_us[later], force[later].astype(np.float64), None)


@dataclass(frozen=True, slots=True)
class ConstantEstimator:
    """Says the same whatever the sensor sees: what any model must beat.

    Attributes:
        force: What it says [N].
        window_us: One estimate per so much time [us].
    """

    force: float
    window_us: int = 2000

    def estimate(self, trial: TrialArrays) -> TrialEstimate:
        """Return the constant on the windows that other models are judged on."""
        ends = _judged_windows(trial, self.window_us)
        return _beside(trial, ends, np.full(len(ends), self.force), None)


def known_force(trial: TrialArrays, window_us: int = 2000) -> TrialEstimate:
    """Return the known force itself on the windows that models are judged on."""
    ends = _judged_windows(trial, window_us)
    return _beside(trial, ends, trial.label().at(ends).astype(np.float64), None)


def _judged_windows(trial: TrialArrays, window_us: int) -> NDArray[np.int64]:
    return window_ends(trial, trial.label(), window_us, _settled_us(trial, SETTLE_FRAMES))


def _settled_us(trial: TrialArrays, frames: int) -> int:
    return int(trial.arrival_us[min(frames, len(trial.arrival_us)) - 1])


def constant_estimator(force: float) -> TrialEstimator:
    """Return the estimator that always says `force` [N]."""
    return ConstantEstimator(force)


def load_estimator(path: Path) -> TrialEstimator:
    """Return the estimator of a weight file of either kind.

    Raises:
        ModelError: The file is missing, damaged, or of another architecture.
    """
    if architecture_of(path) == PAPER:
        return PaperEstimator(load_paper_model(path).network)
    return StreamingEstimator(load_model(path))


def _beside(
    trial: TrialArrays,
    t_us: NDArray[np.int64],
    force: NDArray[np.float64],
    frames_only: NDArray[np.float64] | None,
    deviation: NDArray[np.float64] | None = None,
) -> TrialEstimate:
    label = trial.label()
    inside = (t_us >= label.t_us[0]) & (t_us <= label.t_us[-1])
    if not inside.any():
        raise DatasetError(
            f'{trial.origin.get("name")}: no estimate at a time of which the force is known'
        )
    times = t_us[inside]
    reference = trial.reference if trial.truth is not None else None
    return TrialEstimate(
        name=str(trial.origin.get('name', 'trial')),
        profile=trial.profile,
        device=str(trial.origin.get('device_seed', trial.origin.get('sensor', 'unknown'))),
        t_us=times,
        force=force[inside],
        known=label.at(times).astype(np.float64),
        reference=None if reference is None else reference.at(times).astype(np.float64),
        frames_only=None if frames_only is None else frames_only[inside],
        deviation=None if deviation is None else deviation[inside],
    )
