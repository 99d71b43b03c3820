# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Run models over trials as on a live stream; trials that cannot be used are reported."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixtac_core.events.arrays import Events
from mixtac_core.events.errors import MixtacError
from mixtac_core.recordings.messages import left_aligned
from mixtac_fger.estimator import open_estimator
from mixtac_fger.streaming import ForceEstimator
from mixtac_fger.weights import Model
from mixtac_learning.network import usual_device
from mixtac_learning.paper.networks import PAPER_ARCHITECTURE, PaperNetwork, paper_network_of
from mixtac_learning.paper.samples import FULL_SCALE, SETTLE_FRAMES, make_paper_sample, run_samples
from mixtac_learning.trials.bags import TrialSource
from mixtac_learning.trials.trial import (
    DatasetError,
    TrialArrays,
    camera_end_us,
    camera_start_us,
    sensor_of,
)


@dataclass(frozen=True, slots=True, eq=False)
class TrialEstimate:
    """Estimates of one trial; T windows on the camera clock.

    Attributes:
        name: Name of the trial.
        profile: Its force profile.
        device: Identifier of its sensor.
        t_us: End of each window [us], int64 [T].
        force: Estimate [N], float64 [T].
        known: Force to compare with: the true one, else the reference's [N] [T].
        reference: Reference's force, None if it is absent or equals `known` [N] [T].
        frames_only: The model's force of the latest frame, None if it has none [N] [T].
        deviation: Standard deviation that the model gives, None where it gives none [N] [T].
        reasons: Values of `mixtac_fger.validity.Reason`, None where that is not known, uint8 [T].
        across: `mixtac_fger.force_path.Shear` of each window, nan where unknown, [T, 5]; None of an
            estimator that never knows it.
        known_across: True force x and y [N] and torque z [Nm], None where unknown [T, 3].
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
    reasons: NDArray[np.uint8] | None = None
    across: NDArray[np.float64] | None = None
    known_across: NDArray[np.float64] | None = None

    @property
    def interval_s(self) -> float:
        """Time between estimates [s]."""
        steps = np.diff(self.t_us)
        return 1e-6 * float(np.median(steps)) if len(steps) else 0.002


TrialEstimator = Callable[[TrialArrays], TrialEstimate]
"""Estimates a trial; raises a MixtacError if the trial cannot be used."""


class Window(NamedTuple):
    """What a live estimator receives in one window: frames, then events.

    Attributes:
        end_us: End of the window, camera clock [us].
        frames: Left-aligned images, uint16 [height, width], with the centres of their exposures
            [us].
        events: Events of the window.
        lost_before: Whether events before them were lost.
    """

    end_us: int
    frames: list[tuple[NDArray[np.uint16], int]]
    events: Events
    lost_before: bool


def windows_of(trial: TrialArrays, width_us: int) -> Iterator[Window]:
    """Yield the windows of a trial in order of arrival, without those whose events were lost.

    Args:
        trial: Events and frames; a frame comes in the window of its `arrival_us`.
        width_us: Length of a window [us].

    Raises:
        DatasetError: The force of the trial is not known.
    """
    label = trial.label()
    middle = (trial.exposure_start_us + trial.exposure_end_us) // 2
    # A log of forces may begin hours before the camera.
    known = max(int(label.t_us[0]), camera_start_us(trial))
    begin = min(int(trial.arrival_us[0]), known) // width_us * width_us
    last = min(int(label.t_us[-1]), camera_end_us(trial))
    ends = np.arange(begin + width_us, last + 1, width_us)
    cuts = np.searchsorted(trial.events.t, [begin, *ends])
    arrived = np.searchsorted(trial.arrival_us, ends, side='right').tolist()
    lost = np.zeros(len(ends), np.bool_)
    for before, after in trial.gaps_us:
        lost |= (ends > before) & (ends - width_us < after)
    done = 0
    for index, end in enumerate(ends.tolist()):
        if lost[index]:
            continue
        frames = [
            (left_aligned(np.minimum(trial.frames[k], np.uint16(FULL_SCALE))), int(middle[k]))
            for k in range(done, arrived[index])
        ]
        done = max(done, arrived[index])
        events = trial.events[cuts[index] : cuts[index + 1]]
        yield Window(end, frames, events, index > 0 and bool(lost[index - 1]))


def stream(model: Model, trial: TrialArrays) -> TrialEstimate:
    """Feed a trial to the live estimator in order of arrival.

    Args:
        model: Content of a weight file, of any architecture.
        trial: Events, frames and force.

    Returns:
        The live estimates of the trial, from its first force on.

    Raises:
        DatasetError: The force of the trial is not known, or there is no estimate: the trial
            begins with too few still frames.
    """
    opened = open_estimator(model)
    # Trials begin without contact: the first frames are the zero.
    estimator = ForceEstimator(opened, assume_free=True)
    rows = []
    for window in windows_of(trial, opened.window_us):
        for image, middle_us in window.frames:
            estimator.push_frame(image, middle_us)
        for found in estimator.push_events(
            window.events, window.end_us, lost_before=window.lost_before
        ):
            deviation, shear = found.deviation or 0.0, found.shear or (np.nan,) * 5
            measured = (found.force, estimator.frame_force, deviation, found.reason)
            rows.append((found.end_us, *measured, *shear))
    table = np.array(rows, np.float64).reshape(-1, 10)
    across = table[:, 5:]
    return _estimate(
        trial,
        table[:, 0].astype(np.int64),
        force=table[:, 1],
        frames_only=table[:, 2],
        deviation=table[:, 3] if opened.gives_deviation else None,
        reasons=table[:, 4].astype(np.uint8),
        across=None if np.isnan(across).all() else across,
    )


def trial_estimator(model: Model) -> TrialEstimator:
    """Return the estimator of a model.

    It is the live one, except for the paper's networks, which run half a second at a time, on a
    GPU where there is one.

    Raises:
        ModelError: The weights do not fit their architecture, or it is unknown.
    """
    if model.architecture == PAPER_ARCHITECTURE:
        return partial(paper_estimate, paper_network_of(model).to(usual_device()))
    open_estimator(model)
    return partial(stream, model)


def paper_estimate(network: PaperNetwork, trial: TrialArrays) -> TrialEstimate:
    """Return the estimates of one of the paper's networks, in evaluation mode.

    The first `SETTLE_FRAMES` frames do not count, so that all models are judged on the same
    windows.

    Raises:
        DatasetError: The frames of the trial are too few or of another size.
    """
    sample = make_paper_sample(network.config, trial)
    (force,) = run_samples(network, [sample])
    later = sample.window_end_us > trial.arrival_us[:SETTLE_FRAMES][-1]
    return _estimate(trial, sample.window_end_us[later], force=force[later].astype(np.float64))


def _estimate(
    trial: TrialArrays,
    t_us: NDArray[np.int64],
    **columns: NDArray[Any] | None,
) -> TrialEstimate:
    """Return estimates beside the known force, at the times at which it is known."""
    label, name = trial.label(), str(trial.origin.get('name', 'trial'))
    inside = (t_us >= label.t_us[0]) & (t_us <= label.t_us[-1])
    if not inside.any():
        remedy = f'begin trials with {SETTLE_FRAMES} frames without contact'
        raise DatasetError(f'{name} gives no estimate', remedy=remedy)
    times = t_us[inside]
    reference = trial.reference if trial.truth is not None else None
    fields: dict[str, Any] = {
        name: None if column is None else column[inside] for name, column in columns.items()
    }
    return TrialEstimate(
        name=name,
        profile=trial.profile,
        device=sensor_of(trial.origin, 'unknown'),
        t_us=times,
        known=label.at(times).astype(np.float64),
        reference=None if reference is None else reference.at(times).astype(np.float64),
        known_across=None if trial.across is None else trial.across.at(times).astype(np.float64),
        **fields,
    )


def judge_sources(
    estimator: TrialEstimator, sources: Iterable[TrialSource]
) -> tuple[list[TrialEstimate], dict[str, str]]:
    """Estimate all trials, one in memory at a time.

    Args:
        estimator: The model.
        sources: Trials.

    Returns:
        Estimates of the trials that can be used; why the others cannot, by name.

    Raises:
        DatasetError: No trial can be used.
    """
    found: list[TrialEstimate] = []
    skipped: dict[str, str] = {}
    for source in sources:
        try:
            found.append(estimator(source.load()))
        except MixtacError as error:
            skipped[source.name] = str(error)
    if not found:
        first = next(iter(skipped.values()), 'there are none')
        raise DatasetError(f'none of {len(skipped)} trials can be evaluated: {first}')
    return found, skipped
