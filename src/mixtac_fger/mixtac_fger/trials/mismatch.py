# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Trials of a sensor that differs from the one that was trained on in a way nobody told.

A network that uses the frames' gradients to read events does well in a simulator, in which both
come from one and the same brightness. These changes break that bond.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from mixtac_events.arrays import Events
    from mixtac_fger.trials.trial_arrays import TrialArrays

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


def misdated(trial: TrialArrays) -> TrialArrays:
    """Return a trial whose frames are said to be exposed `LATE_US` later than they were."""
    return replace(
        trial,
        exposure_start_us=trial.exposure_start_us + LATE_US,
        exposure_end_us=trial.exposure_end_us + LATE_US,
    )


def holed(trial: TrialArrays) -> TrialArrays:
    """Return a trial with `DEAD` of the pixels dead, the same ones in events and frames."""
    rows, columns = trial.frames.shape[1:]
    dead = np.random.default_rng(0).random((rows, columns)) < DEAD
    frames = np.where(dead, np.uint16(0), trial.frames)
    events: Events = trial.events[~dead[trial.events.y, trial.events.x]]
    return replace(trial, frames=frames, events=events)


MISMATCHES: dict[str, Callable[[TrialArrays], TrialArrays]] = {
    'blur': blurred,
    'shading': shaded,
    'exposure_3ms': misdated,
    'dead_pixels': holed,
}
"""Changes by name."""
