# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What a model says of a trial, beside the forces that are known of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from mixtac_fger.trials.trial_arrays import TrialArrays


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
