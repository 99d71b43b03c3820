# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Two ways of combining frames and events (paper, section IV-D)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mixtac_lab.experiments.harness import Context, error_rows, experiment, pooled
from mixtac_lab.experiments.report import Outcome, Row
from mixtac_lab.experiments.sizes import FGER, FUSION, STATIC
from mixtac_lab.experiments.training import MODELS, Estimates, force_outcome
from mixtac_lab.figures import PAPER, TRUTH, mark, new_figure, save_figure
from mixtac_learning.train.config import OURS

_FGER_PAPER = {'mae': 0.04, 'rmse': 0.05, 'r2': 0.83}
PAPER_VALUES = {
    OURS: _FGER_PAPER,
    FGER: _FGER_PAPER,
    FUSION: {'mae': 0.10, 'rmse': 0.11, 'r2': 0.10},
}
"""Errors [N] and R2; our network is compared with the paper's."""
_PLACE = 'section IV-D, Fig. 6'


@experiment(order=4)
def fusion(context: Context) -> Outcome:
    """FGER-Net against feature-level fusion, on static forces."""
    return force_outcome(
        context, STATIC, 'fusion', rows=_rows, draw=_draw, conditions='static trials'
    )


def _rows(found: Estimates, *, simulated: bool) -> list[Row]:
    return [
        row
        for model, by_seed in found.items()
        for row in error_rows(
            MODELS[model].label,
            by_seed,
            PAPER_VALUES[model],
            _PLACE,
            'static trials',
            simulated=simulated,
        )
    ]


def _draw(path: Path, found: Estimates, *, simulated: bool) -> Path:
    figure, axes = new_figure(columns=3, width=9.0, height=3.6)
    for ax, (key, title) in zip(
        axes, (('mae', 'MAE [N]'), ('rmse', 'RMSE [N]'), ('r2', 'R2')), strict=True
    ):
        for k, (model, by_seed) in enumerate(found.items()):
            values = [getattr(pooled(trials), key) for trials in by_seed.values()]
            ax.bar(k, np.mean(values), color=MODELS[model].colour, alpha=0.75, width=0.65)
            ax.plot([k] * len(values), values, 'o', color=TRUTH, ms=3)
            label = 'paper' if k == 0 else None
            ax.plot(k + 0.2, PAPER_VALUES[model][key], 'D', color=PAPER, ms=6, label=label)
        ax.axhline(0.0, color=TRUTH, lw=0.6)
        ax.set_xticks(range(len(found)), [MODELS[model].short for model in found], fontsize=8)
        ax.set_title(f'{title}, {mark(simulated)}', fontsize=10)
        ax.grid(visible=False, axis='x')
    axes[0].legend(frameon=False, fontsize=8)
    return save_figure(figure, path)
