# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Running any model over trials as it would run live; trials that cannot be used are named."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np

from mixtac_events.errors import MixtacError
from mixtac_fger.streaming import ForceEstimator
from mixtac_fger.weights import load_model
from mixtac_learning.judge.metrics import CalibrationError, fit_scale
from mixtac_learning.paper.samples import make_paper_sample
from mixtac_learning.paper.segments import run_samples
from mixtac_learning.trials.trial import DatasetError, camera_end_us, window_ends
from mixtac_learning.weights import PAPER_ARCHITECTURE as PAPER
from mixtac_learning.weights import architecture_of, load_paper_model

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from pathlib import Path

    from numpy.typing import NDArray

    from mixtac_fger.weights import LoadedModel
    from mixtac_learning.paper.networks import PaperNetwork
    from mixtac_learning.trials.changes import Losses
    from mixtac_learning.trials.trial import ForceLabel, RecordedTrial, TrialArrays, TrialSource

    Advance = Callable[[], object]


@dataclass(frozen=True, slots=True, eq=False)
class TrialEstimate:
    """Estimates of one trial; T windows on the camera clock.

    Attributes:
        name: Name of the trial.
        profile: Its force profile.
        device: What tells its sensor from others.
        t_us: End of each window [us], int64 [T].
        force: Estimate [N], float64 [T].
        known: Force that counts: the true one where it is known, else the reference's [N] [T].
        reference: Reference's force, None where there is none or it is `known` [N] [T].
        frames_only: The model's force of the latest frame, None where it has none [N] [T].
        deviation: Standard deviation that the model gives, None where it gives none [N] [T].
    """

    name: str
    profile: str
    device: str
    t_us: NDArray[np.int64]
    force: NDArray[np.float64]
    known: NDArray[np.float64]
    reference: NDArray[np.float64] | None
    frames_only: NDArray[np.float64] | None = None
    deviation: NDArray[np.float64] | None = None

    def scaled(self, scale: float) -> TrialEstimate:
        """Return the estimate of a sensor that was calibrated to this scale."""
        frames = None if self.frames_only is None else scale * self.frames_only
        deviation = None if self.deviation is None else scale * self.deviation
        return replace(self, force=scale * self.force, frames_only=frames, deviation=deviation)


class TrialEstimator(Protocol):
    """A model that can be run over a trial as it would run live."""

    def estimate(self, trial: TrialArrays) -> TrialEstimate:
        """Return the model's estimates.

        Raises:
            MixtacError: The trial cannot be used.
        """


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """Estimates of one trial.

    Attributes:
        t_us: End of each window, camera clock [us].
        force: Estimate [N].
        frames_only: Force of the latest frame, held [N].
        truth: True force [N].
        deviation: Standard deviation of the estimate [N]; None of a model that gives none.
    """

    t_us: NDArray[np.int64]
    force: NDArray[np.float64]
    frames_only: NDArray[np.float64]
    truth: NDArray[np.float32]
    deviation: NDArray[np.float64] | None = None

    def scaled(self, scale: float) -> Run:
        """Return the run as an estimator with this `force_scale` would have made it."""
        deviation = None if self.deviation is None else scale * self.deviation
        return replace(
            self,
            force=scale * self.force,
            frames_only=scale * self.frames_only,
            deviation=deviation,
        )


def stream(
    model: LoadedModel,
    trial: RecordedTrial,
    label: ForceLabel,
    frames: int | None = None,
    losses: Losses | None = None,
) -> Run:
    """Feed a trial to the live estimator in order of arrival.

    Args:
        model: Network with its weights.
        trial: Events and frames; frames are handed over at `arrival_us`.
        label: True force on the camera clock.
        frames: Only the first so many frames are handed over; None for all.
        losses: What does not arrive; None for nothing.
    """
    estimator = ForceEstimator(model)
    width = model.config.window_us
    middle = (trial.exposure_start_us + trial.exposure_end_us) // 2
    begin = min(int(trial.arrival_us[0]), int(label.t_us[0])) // width * width
    last = min(int(label.t_us[-1]), camera_end_us(trial))
    ends = np.arange(begin + width, last + 1, width)
    cuts = np.searchsorted(trial.events.t, [begin, *ends])
    arrived = np.searchsorted(trial.arrival_us[:frames], ends, side='right')
    frame_lost = None if losses is None else losses.lost_frames(trial.arrival_us)
    packet_lost = np.zeros(len(ends), np.bool_) if losses is None else losses.lost_packets(ends)
    done = 0
    rows = []
    for index, end in enumerate(ends.tolist()):
        for frame in range(done, arrived[index]):
            if frame_lost is None or not frame_lost[frame]:
                estimator.push_frame(trial.frames[frame], int(middle[frame]))
        done = max(done, int(arrived[index]))
        if packet_lost[index]:
            continue
        events = trial.events[cuts[index] : cuts[index + 1]]
        lost_before = index > 0 and bool(packet_lost[index - 1])
        for found in estimator.push_events(events, end, lost_before=lost_before):
            frame_force = estimator.status().frame_force
            rows.append((found.end_us, found.force, frame_force, found.deviation or 0.0))
    table = np.array(rows, np.float64).reshape(-1, 4)
    times = table[:, 0].astype(np.int64)
    known = model.network.deviation is not None
    deviations = table[:, 3] if known else None
    return Run(times, table[:, 1], table[:, 2], label.at(times), deviations)


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


@dataclass(slots=True)
class Judged:
    """Estimates of trials.

    Attributes:
        estimates: Of those that could be used.
        skipped: Why the others could not, by name.
    """

    estimates: list[TrialEstimate] = field(default_factory=list)
    skipped: dict[str, str] = field(default_factory=dict)


def judge_sources(
    estimator: TrialEstimator,
    sources: Iterable[TrialSource],
    advance: Advance = lambda: None,
) -> Judged:
    """Estimate all trials, one in memory at a time.

    Args:
        estimator: The model.
        sources: Trials.
        advance: Called after each.

    Raises:
        DatasetError: No trial can be used.
    """
    judged = Judged()
    for source in sources:
        try:
            judged.estimates.append(estimator.estimate(source.load()))
        except MixtacError as error:
            judged.skipped[source.name] = str(error)
        advance()
    if not judged.estimates:
        first = next(iter(judged.skipped.values()), 'there are none')
        raise DatasetError(f'none of {len(judged.skipped)} trials can be judged: {first}')
    return judged


def sensor_scales(
    estimator: TrialEstimator,
    presses: Iterable[TrialSource],
    advance: Advance = lambda: None,
    fallback: float | None = None,
) -> dict[str, float]:
    """Return the scale of each sensor from one press against a known force.

    Args:
        estimator: The model.
        presses: One trial per sensor that nothing else is judged on.
        advance: Called after each.
        fallback: Scale of a sensor whose press the model does not see; None to fail.

    Raises:
        CalibrationError: As said.
        MixtacError: A press cannot be used.
    """
    scales = {}
    for source in presses:
        press = estimator.estimate(source.load())
        try:
            scales[press.device] = fit_scale(press.force, press.known).force_scale
        except CalibrationError:
            if fallback is None:
                raise
            scales[press.device] = fallback
        advance()
    return scales
