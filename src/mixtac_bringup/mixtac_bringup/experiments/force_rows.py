# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Figures of force estimates as rows, the same way in all experiments."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mixtac_bringup.experiments.rows import Row, Value
from mixtac_fger.judge.time_errors import peak_error
from mixtac_fger.metrics import measure

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from mixtac_fger.judge.trial_estimate import TrialEstimate
    from mixtac_fger.metrics import Metrics


def pooled(estimates: Sequence[TrialEstimate]) -> Metrics:
    """Return the errors of all windows of some trials together."""
    known = np.concatenate([each.known for each in estimates])
    return measure(known, np.concatenate([each.force for each in estimates]))


def error_rows(
    name: str,
    by_seed: Mapping[int, Sequence[TrialEstimate]],
    paper: Mapping[str, float],
    place: str,
    conditions: str,
    *,
    simulated: bool,
) -> list[Row]:
    """Return MAE, RMSE and R2 of a model; one value per seed.

    Args:
        name: Of the model.
        by_seed: Its estimates.
        paper: The paper's numbers by `mae`, `rmse`, `r2`; missing ones were not given.
        place: Where in the paper.
        conditions: Of the data.
        simulated: Whether the data are.
    """
    metrics = [pooled(estimates) for estimates in by_seed.values()]
    return [
        Row(
            f'{name}: {title}',
            Value.of(getattr(each, key) for each in metrics),
            paper.get(key),
            place if key in paper else '',
            unit,
            conditions,
            simulated,
        )
        for key, title, unit in (('mae', 'MAE', 'N'), ('rmse', 'RMSE', 'N'), ('r2', 'R2', ''))
    ]


def constant_row(
    by_seed: Mapping[int, Sequence[TrialEstimate]], conditions: str, *, simulated: bool
) -> Row:
    """Return the MAE of the best constant: what no sensor at all achieves."""
    values = Value.of(pooled(estimates).constant_mae for estimates in by_seed.values())
    return Row('best constant: MAE', values, None, '', 'N', conditions, simulated)


def peak_row(
    name: str,
    by_seed: Mapping[int, Sequence[TrialEstimate]],
    conditions: str,
    *,
    simulated: bool,
) -> Row:
    """Return the mean relative error at the largest force of each trial."""
    values = Value.of(
        float(np.mean([peak_error(e.known, e.force, interval_s(e)) for e in estimates]))
        for estimates in by_seed.values()
    )
    return Row(f'{name}: error of the peak', values, None, '', '', conditions, simulated)


def interval_s(estimate: TrialEstimate) -> float:
    """Return the time between estimates [s]."""
    return 1e-6 * float(np.median(np.diff(estimate.t_us)))


def rate_hz(estimates: Sequence[TrialEstimate]) -> float:
    """Return how many different forces per second a model gives [Hz]."""
    changes = sum(int(np.count_nonzero(np.diff(e.force))) for e in estimates)
    return changes / sum(1e-6 * float(e.t_us[-1] - e.t_us[0]) for e in estimates)
