# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What a model would reach that sees everything: all errors are the stiffness that nobody sees.

A camera measures lengths and times. A newton needs a mass as well, and the only one in reach is
the gel's modulus: two sensors of the same geometry, gel and mesh of one twice as stiff, show the
same picture under forces of which one is twice the other. What the ratio of mesh to gel gives away
is left out.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

from mixtac_fger import generation
from mixtac_fger.judge.estimators import known_force
from mixtac_fger.trial_plan import TrialSpec

if TYPE_CHECKING:
    from mixtac_fger.judge.trial_estimate import TrialEstimate
    from mixtac_fger.trials.trial_arrays import TrialArrays

_FIELDS = tuple(field.name for field in fields(TrialSpec))


@dataclass(frozen=True, slots=True)
class StiffnessBound:
    """Knows the true force but for the factor by which a simulated gel is stiffer than usual.

    Attributes:
        known_devices: Seeds of the sensors whose usual stiffness it has learned.
    """

    known_devices: frozenset[int]

    def estimate(self, trial: TrialArrays) -> TrialEstimate:
        """Return the force that the picture of a simulated trial means on a usual gel."""
        spec = TrialSpec(**{name: trial.origin[name] for name in _FIELDS})
        known = spec.device_seed in self.known_devices
        factor = generation.stiffness(spec, known_sensor=known)
        return known_force(trial).scaled(1.0 / factor)
