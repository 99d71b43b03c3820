# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A weight that falls, bounces and comes to rest (paper, section IV-E)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mixtac_lab.experiments.harness import Context, error_rows, experiment, peak_row
from mixtac_lab.experiments.report import Outcome, Row
from mixtac_lab.experiments.sizes import IMPACT
from mixtac_lab.experiments.training import MODELS, Estimates, force_outcome
from mixtac_lab.figures import mark, new_figure, plot_forces, save_figure
from mixtac_learning.train.config import OURS

PAPER_N = {'mae': 0.05, 'rmse': 0.07}
"""Errors [N]."""
_PLACE = 'section IV-E, Fig. 7'
CLOSE_S = (-0.02, 0.3)
"""Span of the close-up around the first impact [s]."""
WHOLE_S = (-0.3, 1.5)


@experiment(order=5)
def impact(context: Context) -> Outcome:
    """20 g from 5 cm: impact, bounces and hold."""
    return force_outcome(
        context, IMPACT, 'impact', rows=_rows, draw=_draw, conditions='whole trials'
    )


def _rows(found: Estimates, *, simulated: bool) -> list[Row]:
    rows: list[Row] = []
    text = 'largest force, estimate within 10 ms of it; share of it'
    for model, by_seed in found.items():
        name = MODELS[model].label
        rows += error_rows(name, by_seed, PAPER_N, _PLACE, 'whole trials', simulated=simulated)
        rows.append(peak_row(name, by_seed, text, simulated=simulated))
    return rows


def _draw(path: Path, found: Estimates, *, simulated: bool) -> Path:
    figure, axes = new_figure(columns=2, width=10.0, height=3.8)
    first = found[OURS][0][0]
    # The synchronising taps reach 2 N at most; the impact is the largest force.
    onset = first.t_us[int(np.argmax(first.known))]
    curves = {MODELS[model]: by_seed[0][0] for model, by_seed in found.items()}
    for ax, span in zip(axes, (WHOLE_S, CLOSE_S), strict=True):
        plot_forces(ax, first, curves, onset, span, simulated=simulated)
        ax.set(xlabel='time from the peak [s]')
    axes[0].set(ylabel='normal force [N]', title=f'{first.name}, {mark(simulated)}')
    axes[0].title.set_fontsize(9)
    axes[1].legend(frameon=False, fontsize=8)
    return save_figure(figure, path)
