# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Trials whose results are kept, with the curve of the object's place."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from mixtac_bringup.slip_bench.kept import digest
from mixtac_bringup.slip_bench.trial import KNOCK_S, TrialResult, run_trial

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_bringup.slip_bench.closed_loop import LoopRecord
    from mixtac_bringup.slip_bench.kept import Kept
    from mixtac_bringup.slip_bench.trial import TrialPlan

CURVE_MS: Final = np.arange(-10.0, 81.0)
"""Times of the curve from the begin of the blow [91] [ms]."""


def kept_trial(plan: TrialPlan, kept: Kept) -> tuple[TrialResult, NDArray[np.float64]]:
    """Return the result of a trial and the object's place at `CURVE_MS` [91] [mm].

    Args:
        plan: What it fixes.
        kept: Holds the trials that were run before.

    Raises:
        SlipControlError: The controller could not be enabled.
    """

    def measure() -> dict[str, Any]:
        result, record = run_trial(plan)
        return {'result': result.as_dict(), 'curve': place_curve(record).round(5).tolist()}

    entry = kept.get(f'trial {plan.name} {plan.seed} {digest(plan)}', measure)
    return TrialResult(**entry['result']), np.array(entry['curve'])


def place_curve(record: LoopRecord) -> NDArray[np.float64]:
    """Return the object's place at `CURVE_MS` from where the blow met it [91] [mm]."""
    t_ms = 1e-3 * record.t_us - 1e3 * KNOCK_S
    start = np.interp(0.0, t_ms, record.object_mm)
    return np.asarray(np.interp(CURVE_MS, t_ms, record.object_mm) - start)
