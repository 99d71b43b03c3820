# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Trials that the simulator makes when they are loaded."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from mixtac_learning.trials.trial import AcrossLabel, TrialArrays, aligned_force, true_force
from mixtac_sim.world import plans as generation
from mixtac_sim.world.plans import TrialSpec
from mixtac_sim.world.sensor import truth_wrench
from mixtac_sim.world.trial import Trial


@dataclass(frozen=True, slots=True)
class SimulatedSource:
    """A trial that the simulator makes when it is asked for.

    Attributes:
        spec: The trial.
    """

    spec: TrialSpec

    @property
    def name(self) -> str:
        """A file name of its seeds, profile and preset."""
        return self.spec.name

    @property
    def origin(self) -> dict[str, Any]:
        """The fields of the specification."""
        return asdict(self.spec) | {'name': self.name, 'simulated': True}

    def content_key(self) -> str:
        """Return the trial's name with the digest of the simulator."""
        return f'{generation.simulator_digest()} {self.name}'

    def load(self) -> TrialArrays:
        """Simulate the trial.

        Raises:
            SimulationError: Unknown profile or preset, or too short a duration.
        """
        return arrays_of(generation.simulate(self.spec), self.origin)


def arrays_of(trial: Trial, origin: dict[str, Any]) -> TrialArrays:
    """Return a simulated trial as arrays, its reference aligned by the simulator's clock map."""
    scale, offset_us = trial.clock
    return TrialArrays(
        events=trial.events,
        frames=trial.frames,
        exposure_start_us=trial.exposure_start_us,
        exposure_end_us=trial.exposure_end_us,
        arrival_us=trial.arrival_us,
        truth=true_force(trial.truth),
        reference=aligned_force(
            trial.reference_t_us, trial.reference_wrench[:, 2], scale, offset_us
        ),
        across=AcrossLabel(
            trial.truth['t_us'].astype(np.float64), truth_wrench(trial.truth)[:, [0, 1, 5]]
        ),
        origin=origin,
    )
