# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Force from events alone: a linear map from events to increments of the force, summed up.

It sees one image, from before the first contact, and then nothing but events. What it misses or
counts twice stays in the sum, so its error grows with time: the drift that frames are there for.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mixtac_fger.errors import DatasetError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from mixtac_events.arrays import Events
    from mixtac_fger.dataset import ForceLabel, RecordedTrial

WINDOW_US = 10_000
"""Window of an increment [us]; a linear sum does not depend on it, the noise of a fit does."""
CELL_PX = 44
"""Side of a cell [px]: eight columns and six rows."""
RIDGES = (0.01, 0.1, 1.0, 10.0, 100.0)
"""Penalties to choose from, over the mean square of the fit's (standardised) features."""


@dataclass(frozen=True, slots=True, eq=False)
class Increments:
    """Events and force of one trial in windows, from the end of the image on.

    Attributes:
        t_us: Ends of the windows, camera clock [us], int64 [n].
        features: Sums per cell of polarity times the image's log-gradient (x, y), ON and OFF
            events, float64 [n, 4 * cells].
        force: True force at the ends [n + 1] [N]; the first is where the integral starts.
    """

    t_us: NDArray[np.int64]
    features: NDArray[np.float64]
    force: NDArray[np.float64]


def increments(trial: RecordedTrial, label: ForceLabel, reference_frames: int) -> Increments:
    """Return the windows of a trial.

    Args:
        trial: Events and frames; only the first frames are looked at.
        label: True force on the camera clock.
        reference_frames: Number of frames before the first contact.

    Raises:
        DatasetError: The trial ends before its reference frames do.
    """
    begin = int(trial.exposure_end_us[reference_frames - 1])
    edges = np.arange(begin, int(label.t_us[-1]) + 1, WINDOW_US)
    if len(edges) < 3:
        raise DatasetError(f'trial ends {edges.size * WINDOW_US} us after its reference frames')
    image = trial.frames[:reference_frames].mean(axis=0)
    features = _sums(trial.events, image, edges)
    return Increments(edges[1:], features, label.at(edges).astype(np.float64))


def _sums(
    events: Events, image: NDArray[np.floating], edges: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Return the features of the windows between edges [us]."""
    rows, columns = image.shape
    wide, high = -(-columns // CELL_PX), -(-rows // CELL_PX)
    inside = events[np.searchsorted(events.t, edges[0]) : np.searchsorted(events.t, edges[-1])]
    window = (inside.t - edges[0]) // WINDOW_US
    x, y = inside.x.astype(np.int64), inside.y.astype(np.int64)
    place = (window * high + y // CELL_PX) * wide + x // CELL_PX
    slope_y, slope_x = np.gradient(np.log(np.maximum(image, 1.0)))
    sign = np.where(inside.polarity, 1.0, -1.0)
    weights = (sign * slope_x[y, x], sign * slope_y[y, x], sign > 0.0, sign < 0.0)
    size = (len(edges) - 1) * wide * high
    sums = [np.bincount(place, weight, size).reshape(-1, wide * high) for weight in weights]
    return np.concatenate(sums, axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class EventIntegrator:
    """A linear map from the events of a window to the increment of the force [N].

    Attributes:
        gains: Increment per unit of each feature [4 * cells] [N].
        offset: Increment of a window without events [N]: less what noise alone would add.
    """

    gains: NDArray[np.float64]
    offset: float = 0.0

    @classmethod
    def fit(cls, trials: Sequence[Increments], ridge: float = RIDGES[0]) -> EventIntegrator:
        """Return the map of least squares over training trials.

        Args:
            trials: Training trials.
            ridge: Penalty of large gains.
        """
        features = np.concatenate([trial.features for trial in trials])
        change = np.concatenate([np.diff(trial.force) for trial in trials])
        centre, scale = features.mean(axis=0), features.std(axis=0) + 1e-9
        even = (features - centre) / scale
        square = even.T @ even / len(even)
        square[np.diag_indices_from(square)] += ridge
        gains = np.linalg.solve(square, even.T @ (change - change.mean()) / len(even)) / scale
        return cls(gains, float(change.mean() - centre @ gains))

    @classmethod
    def choose(cls, trials: Sequence[Increments]) -> EventIntegrator:
        """Return the map with the penalty that integrates best on training trials left out.

        Args:
            trials: Training trials, two or more; each is left out once.
        """

        def error(ridge: float) -> float:
            quarters = [
                judge_integrator(cls.fit([t for t in trials if t is not out], ridge), [out])[0]
                for out in trials
            ]
            return float(np.mean(quarters))

        return cls.fit(trials, min(RIDGES, key=error))

    def changes(self, trial: Increments) -> NDArray[np.float64]:
        """Return the increment of each window [n] [N]."""
        return np.asarray(trial.features @ self.gains + self.offset)

    def integrate(self, trial: Increments) -> NDArray[np.float64]:
        """Return the force at the end of each window [n] [N], from the true one at the start."""
        return np.asarray(trial.force[0] + np.cumsum(self.changes(trial)))


def judge_integrator(
    integrator: EventIntegrator, trials: Sequence[Increments]
) -> tuple[NDArray[np.float64], float]:
    """Return mean absolute errors in four quarters of each trial, and how good increments are.

    Args:
        integrator: Fitted to other trials.
        trials: Unseen ones.

    Returns:
        Errors [trial, 4] [N], and R2 of the increments.
    """
    quarters, truth, found = [], [], []
    for trial in trials:
        error = np.abs(integrator.integrate(trial) - trial.force[1:])
        quarters.append([part.mean() for part in np.array_split(error, 4)])
        truth.append(np.diff(trial.force))
        found.append(integrator.changes(trial))
    whole, rest = np.concatenate(truth), np.concatenate(truth) - np.concatenate(found)
    return np.array(quarters), 1.0 - float(np.sum(rest**2) / np.sum((whole - whole.mean()) ** 2))


def summarise_integrator(quarters: NDArray[np.float64], r2: float) -> dict[str, float]:
    """Return the figures of a report.

    Args:
        quarters: Of `judge_integrator` [trial, 4] [N].
        r2: Of the increments.

    Returns:
        `integrator_increment_r2`; `integrator_early_mae` and `integrator_late_mae` [N] in the first
        and last quarter with their spreads between trials (`_sd`); `integrator_growth`, the ratio
        of the means; `integrator_growing`, the share of trials whose error grows.
    """
    early, late = quarters[:, 0], quarters[:, -1]
    return {
        'integrator_increment_r2': r2,
        'integrator_early_mae': float(early.mean()),
        'integrator_early_sd': float(early.std()),
        'integrator_late_mae': float(late.mean()),
        'integrator_late_sd': float(late.std()),
        'integrator_growth': float(late.mean() / early.mean()),
        'integrator_growing': float(np.mean(late > early)),
    }
