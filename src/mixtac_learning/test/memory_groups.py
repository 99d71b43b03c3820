# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Trials in memory, as the simulator returns them."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING

import numpy as np

from mixtac_sim.world.sensor import TRUTH_DTYPE

if TYPE_CHECKING:
    from mixtac_learning.trials.trial import TrialArrays


def simulation_of(trial: TrialArrays, **fields) -> SimpleNamespace:
    """Return a trial as the simulator does; its reference is 10 mN off."""
    names = ('events', 'frames', 'arrival_us', 'exposure_start_us', 'exposure_end_us')
    label = trial.truth
    truth, wrench = np.zeros(len(label.t_us), TRUTH_DTYPE), np.zeros((len(label.t_us), 6))
    truth['t_us'], truth['fz'], wrench[:, 2] = label.t_us, label.force, label.force + 0.01
    made = {'truth': truth, 'reference_t_us': label.t_us.astype(np.int64)}
    made |= {'reference_wrench': wrench, 'clock': (1.0, 0.0)}
    return SimpleNamespace(**{name: getattr(trial, name) for name in names} | made | fields)
