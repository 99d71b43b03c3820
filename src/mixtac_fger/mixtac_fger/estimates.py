# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the live estimator gives out: forces, and figures on itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple


class Estimate(NamedTuple):
    """The force at the end of a window, and how far it can be trusted.

    Attributes:
        end_us: End of the window, camera clock [us].
        force: Normal force [N].
        deviation: Standard deviation of it [N]; None of a model that gives none.
        frame_age_us: From the centre of the latest frame's exposure to the end of the window [us].
        complete: All packets of the window arrived.
        saturated: So many events that the sensor's readout is likely to have lost some.
    """

    end_us: int
    force: float
    deviation: float | None = None
    frame_age_us: int = 0
    complete: bool = True
    saturated: bool = False


@dataclass(slots=True)
class EstimatorCounts:
    """What the estimator counts; see `EstimatorStatus`."""

    windows: int = 0
    estimates: int = 0
    withheld: int = 0
    incomplete: int = 0
    saturated: int = 0
    frames: int = 0
    frames_dropped: int = 0
    frames_off_clock: int = 0
    resets: int = 0


@dataclass(frozen=True, slots=True)
class EstimatorStatus:
    """What the estimator says of itself.

    Attributes:
        ready: Whether windows give forces now.
        reason: Why not; empty when ready.
        windows: Windows closed so far.
        estimates: Forces given so far.
        withheld: Windows without a force although there was an estimate: no packet told of them, or
            the latest frame was too old.
        incomplete: Forces of windows of which a part of the packets is missing.
        saturated: Windows with so many events that the sensor is likely to have lost some.
        frames: Frames applied so far.
        frames_dropped: Frames replaced by a newer one before they were encoded or applied.
        frames_off_clock: Frames not used as their exposure is not near the time of the events.
        bad_frames: Frames of a size that the model does not read (background only).
        gaps: Holes in the stream.
        skipped_windows: Windows in holes so long that the estimate began anew.
        late_events: Events dropped since their window was closed.
        resets: Times the clock went backwards or the state was not finite.
        frame_age_us: Camera time since the centre of the latest frame's exposure, -1 without one.
        frame_force: Frames-only force of the latest frame [N].
        deviation: Standard deviation of the latest force [N], -1 of a model that gives none.
    """

    ready: bool
    reason: str
    windows: int
    estimates: int
    withheld: int
    incomplete: int
    saturated: int
    frames: int
    frames_dropped: int
    frames_off_clock: int
    bad_frames: int
    gaps: int
    skipped_windows: int
    late_events: int
    resets: int
    frame_age_us: int
    frame_force: float
    deviation: float
