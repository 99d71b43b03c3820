# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Long holds: whether the error grows with time (paper, section IV-B)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixtac_lab.experiments.harness import Context, error_rows, experiment, interval_s
from mixtac_lab.experiments.report import Outcome, Row, Value
from mixtac_lab.experiments.sizes import HOLD
from mixtac_lab.experiments.training import MODELS, Estimates, force_outcome
from mixtac_lab.figures import PAPER, mark, new_figure, save_figure
from mixtac_learning.judge.estimators import TrialEstimate
from mixtac_learning.judge.metrics import ROLLING_S, moving_mean

PAPER_N = (0.08, 0.07, 0.07, 0.07, 0.06)
"""Medians per bin [N]."""
BIN_S = 5.0
_PLACE = 'section IV-B, Fig. 4'
_CONDITIONS = 'rolling MAE in a sliding window of 0.5 s, median of all trials of a seed in 5 s'
Bins = list['NDArray[np.float64]']


@experiment(order=2)
def stability(context: Context) -> Outcome:
    """Long holds: whether the error grows within 25 s."""
    return force_outcome(
        context, HOLD, 'stability', rows=_rows, draw=_draw, conditions='whole trials'
    )


def rolling_bins(estimate: TrialEstimate) -> Bins:
    """Return the rolling error of a trial [N], in spans of 5 s from its start."""
    interval = interval_s(estimate)
    width = max(round(ROLLING_S / interval), 1)
    error = moving_mean(np.abs(estimate.force - estimate.known), width)
    which = ((estimate.t_us - estimate.t_us[0]) * 1e-6 // BIN_S).astype(np.int64)
    last = max(int(which[-1]), 0)
    # A remainder of less than half a span belongs to the previous span.
    if last and np.count_nonzero(which == last) * interval < 0.5 * BIN_S:
        which[which == last] = last - 1
        last -= 1
    return [error[which == k] for k in range(last + 1)]


def _pooled_bins(trials: Sequence[TrialEstimate]) -> Bins:
    cut = [rolling_bins(each) for each in trials]
    return [
        np.concatenate([bins[k] for bins in cut if k < len(bins)])
        for k in range(max(len(bins) for bins in cut))
    ]


def _rows(found: Estimates, *, simulated: bool) -> list[Row]:
    rows = []
    for model, by_seed in found.items():
        name = MODELS[model].label
        bins = [_pooled_bins(trials) for trials in by_seed.values()]
        for k in range(max(len(each) for each in bins)):
            paper = PAPER_N[k] if k < len(PAPER_N) else None
            span = f'{BIN_S * k:g} to {BIN_S * (k + 1):g} s'
            medians = Value.of(float(np.median(each[k])) for each in bins if k < len(each))
            title = f'{name}: median rolling MAE, {span}'
            place = _PLACE if paper is not None else ''
            rows.append(Row(title, medians, paper, place, 'N', _CONDITIONS, simulated))
        rows += error_rows(name, by_seed, {}, '', 'whole trials', simulated=simulated)[:1]
    return rows


def _draw(path: Path, found: Estimates, *, simulated: bool) -> Path:
    figure, axes = new_figure(columns=len(found), width=9.0, height=3.6)
    top = 0.0
    for ax, (model, by_seed) in zip(axes, found.items(), strict=True):
        colour = MODELS[model].colour
        bins = _pooled_bins([each for trials in by_seed.values() for each in trials])
        centres = [BIN_S * (k + 0.5) for k in range(len(bins))]
        thin = [values[:: max(len(values) // 3000, 1)] for values in bins]
        parts = ax.violinplot(thin, centres, widths=0.8 * BIN_S, showextrema=False)
        bodies: Any = parts['bodies']
        for body in bodies:
            body.set(facecolor=colour, alpha=0.5)
        medians = [float(np.median(values)) for values in bins]
        ax.hlines(medians, np.array(centres) - 1.2, np.array(centres) + 1.2, colour, lw=2)
        ax.plot(
            centres[: len(PAPER_N)],
            PAPER_N[: len(centres)],
            'D',
            color=PAPER,
            ms=5,
            label="paper's medians",
        )
        top = max(top, *(float(np.quantile(values, 0.99)) for values in bins), 0.1)
        ax.set(title=f'{MODELS[model].label}, {mark(simulated)}', xlabel='time since the start [s]')
        ax.legend(loc='upper right', frameon=False, fontsize=8)
    for ax in axes:
        ax.set_ylim(0.0, 1.1 * top)
    axes[0].set_ylabel('rolling MAE [N]')
    return save_figure(figure, path)
