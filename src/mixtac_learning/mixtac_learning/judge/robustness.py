# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What lost frames, lost packets and gaps of 0.2 s cost, measured on the live estimator."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixtac_events.errors import MixtacError
from mixtac_fger.weights import Model
from mixtac_learning.judge.estimators import TrialEstimate, stream
from mixtac_learning.trials.changes import Losses
from mixtac_learning.trials.trial import DatasetError, TrialArrays, TrialSource

GAP_EVERY_US = 1_500_000
"""From one gap to the next."""
FIRST_GAP_US = 1_000_000
"""From the first estimate to the first gap."""
AFTER_US = 200_000
"""How long after a gap's first estimate counts as after it: five frames at 25 Hz."""
KINDS = {
    'frames_missing_10': Losses(frame_part=0.1),
    'packets_missing_5': Losses(packet_part=0.05),
}
"""Losses at random; the gaps are placed on each trial."""
UNDISTURBED, GAP = 'undisturbed', 'gap_200ms'


def robustness(model: Model, sources: Iterable[TrialSource]) -> dict[str, dict[str, Any]]:
    """Return the figures of a model with and without losses; forces in N, times in ms.

    Args:
        model: Content of a weight file.
        sources: Trials; those that cannot be used are passed over.

    Returns:
        `undisturbed`: `mae`, `windows`. `frames_missing_10`, `packets_missing_5`: `mae`, and
        `given`, the part of the undisturbed windows that still have an estimate. `gap_200ms`:
        `gaps`; means over gaps of `silent_ms`, from the gap's end to the first estimate, and of
        `frames`, those that arrived until then; the largest number of frames, `most_frames`;
        `mae_after` over the `AFTER_US` from that estimate on, and `mae_undisturbed` of the same
        windows without the gap; `mae_during`, of estimates that were given in the gap, if any.

    Raises:
        DatasetError: No trial can be used.
    """
    collected: dict[str, list[dict[str, float]]] = {}
    for source in sources:
        try:
            trial = source.load()
            rows = _of_trial(model, trial)
        except MixtacError:
            rows = {}
        for kind, found in rows.items():
            collected.setdefault(kind, []).extend(found)
    if not collected:
        raise DatasetError('no trial can be judged for robustness: give trials of some seconds')
    return {kind: _pooled(kind, rows) for kind, rows in collected.items()}


def _of_trial(model: Model, trial: TrialArrays) -> dict[str, list[dict[str, float]]]:
    whole = stream(model, trial)
    if not len(whole.t_us):
        return {}
    rows = {UNDISTURBED: [_errors(whole, whole)]}
    for kind, losses in KINDS.items():
        rows[kind] = [_errors(stream(model, trial, losses=losses), whole)]
    last_us = int(whole.t_us[-1]) - Losses().gap_us - 2 * AFTER_US
    gaps = tuple(range(int(whole.t_us[0]) + FIRST_GAP_US, last_us, GAP_EVERY_US))
    losses = Losses(gaps_us=gaps)
    holed = stream(model, trial, losses=losses)
    rows[GAP] = [_gap(holed, whole, trial, begin, losses) for begin in gaps]
    return rows


def _errors(run: TrialEstimate, whole: TrialEstimate) -> dict[str, float]:
    error = np.abs(run.force - run.known)
    return {'sum': float(error.sum()), 'count': len(error), 'whole': len(whole.t_us)}


def _gap(
    run: TrialEstimate, whole: TrialEstimate, trial: TrialArrays, begin_us: int, losses: Losses
) -> dict[str, float]:
    """Return what happened at one gap; nan where there was nothing."""
    end_us = begin_us + losses.gap_us
    later = run.t_us[run.t_us > end_us]
    first_us = int(later[0]) if len(later) else int(whole.t_us[-1])
    arrived = (trial.arrival_us > end_us) & (trial.arrival_us <= first_us)
    after = (first_us - 1, first_us + AFTER_US)
    return {
        'silent_ms': (first_us - end_us) / 1000.0,
        'frames': float(np.count_nonzero(arrived)),
        'mae_after': _between(run, *after),
        'mae_undisturbed': _between(whole, *after),
        'mae_during': _between(run, begin_us, end_us),
    }


def _between(run: TrialEstimate, after_us: int, until_us: int) -> float:
    chosen: NDArray[np.bool_] = (run.t_us > after_us) & (run.t_us <= until_us)
    error = np.abs(run.force - run.known)[chosen]
    return float(error.mean()) if len(error) else float('nan')


def _pooled(kind: str, rows: list[dict[str, float]]) -> dict[str, Any]:
    if kind != GAP:
        count = sum(row['count'] for row in rows)
        figures = {'mae': sum(row['sum'] for row in rows) / max(count, 1)}
        if kind == UNDISTURBED:
            return {'mae': round(figures['mae'], 4), 'windows': int(count)}
        figures['given'] = count / sum(row['whole'] for row in rows)
        return {name: round(value, 4) for name, value in figures.items()}
    found: dict[str, Any] = {'gaps': len(rows)}
    for name in rows[0] if rows else ():
        values = np.array([row[name] for row in rows])
        if np.isfinite(values).any():
            found[name] = round(float(np.nanmean(values)), 4)
    if rows:
        found['most_frames'] = int(max(row['frames'] for row in rows))
    return found
