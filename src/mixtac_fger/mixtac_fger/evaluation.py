# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Judging a model on trials through the same code that runs live."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from mixtac_fger.streaming import ForceEstimator
from mixtac_fger.windows_of_trial import camera_end_us

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_fger.dataset import ForceLabel, RecordedTrial
    from mixtac_fger.judge.losses import Losses
    from mixtac_fger.weights import LoadedModel


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
