# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Trials made worse on purpose: other optics and pixels than in training.

A network that reads events through the gradients of frames does well in a simulator, where both
come from the same brightness. The mismatches here break that correspondence.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mixtac_events.arrays import Events
from mixtac_learning.trials.trial import TrialArrays, TrialSource


@dataclass(frozen=True, slots=True)
class ChangedSource:
    """A changed trial.

    Attributes:
        source: Where the trial comes from.
        label: Name of the change.
        change: Makes the change.
    """

    source: TrialSource
    label: str
    change: Callable[[TrialArrays], TrialArrays]

    @property
    def name(self) -> str:
        """Name of the trial and of the change."""
        return f'{self.source.name}-{self.label}'

    @property
    def origin(self) -> dict[str, Any]:
        """What is known of the trial."""
        return self.source.origin

    def content_key(self) -> str:
        """Return the key of the source with the change."""
        return f'{self.source.content_key()} {self.label}'

    def load(self) -> TrialArrays:
        """Return the changed trial."""
        return self.change(self.source.load())


BLUR_PX = 1.5
"""Standard deviation of the blur of frames; events stay sharp [px]."""
SHADE = 0.4
"""Part of the light that the corners of the frames lose."""
LATE_US = 3_000
"""Error of the exposure's times [us]."""
DEAD = 0.01
"""Part of the pixels that give neither events nor light."""


def blurred(trial: TrialArrays) -> TrialArrays:
    """Return a trial with frames out of focus by `BLUR_PX`."""
    from scipy.ndimage import gaussian_filter

    frames = np.stack([gaussian_filter(frame, BLUR_PX) for frame in trial.frames])
    return replace(trial, frames=frames)


def shaded(trial: TrialArrays) -> TrialArrays:
    """Return a trial with frames that darken by `SHADE` towards one corner."""
    rows, columns = trial.frames.shape[1:]
    along_y = np.linspace(0.0, 0.5, rows)[:, None]
    along_x = np.linspace(0.0, 0.5, columns)[None]
    factor = 1.0 - SHADE * (along_y + along_x)
    frames = np.stack([np.round(frame * factor).astype(np.uint16) for frame in trial.frames])
    return replace(trial, frames=frames)


def shifted_exposure(trial: TrialArrays) -> TrialArrays:
    """Return a trial whose exposure times are `LATE_US` too late."""
    return replace(
        trial,
        exposure_start_us=trial.exposure_start_us + LATE_US,
        exposure_end_us=trial.exposure_end_us + LATE_US,
    )


def dead_pixels(trial: TrialArrays) -> TrialArrays:
    """Return a trial with `DEAD` of the pixels dead, the same ones in events and frames."""
    rows, columns = trial.frames.shape[1:]
    dead = np.random.default_rng(0).random((rows, columns)) < DEAD
    frames = np.where(dead, np.uint16(0), trial.frames)
    events: Events = trial.events[~dead[trial.events.y, trial.events.x]]
    return replace(trial, frames=frames, events=events)


MISMATCHES: dict[str, Callable[[TrialArrays], TrialArrays]] = {
    'blur': blurred,
    'shading': shaded,
    'exposure_3ms': shifted_exposure,
    'dead_pixels': dead_pixels,
}
"""Changes by name."""
