# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Frames, events, or both (paper, section IV-C and table II)."""

from __future__ import annotations

from pathlib import Path

from mixtac_lab.experiments.harness import Context, error_rows, experiment, rate_hz
from mixtac_lab.experiments.report import Outcome, Row, Value
from mixtac_lab.experiments.sizes import DYNAMIC, EVENTS, FGER, FRAMES
from mixtac_lab.experiments.training import MODELS, Estimates, force_outcome
from mixtac_lab.figures import mark, new_figure, plot_forces, save_figure
from mixtac_learning.train.config import OURS

PAPER_N = {
    FRAMES: {'mae': 0.06, 'rmse': 0.08},
    EVENTS: {'mae': 0.12, 'rmse': 0.14},
    FGER: {'mae': 0.04, 'rmse': 0.05},
    OURS: {'mae': 0.04, 'rmse': 0.05},
}
"""Errors [N]; our network is compared with the paper's."""
PAPER_HZ = {FRAMES: 25.0, EVENTS: 500.0, FGER: 500.0, OURS: 500.0}
_PLACE = 'section IV-C, table II'
_CONDITIONS = 'dynamic trials'
SHOWN_S = 5.0
"""Length of the part shown in the figure [s]."""


@experiment(order=3)
def inputs(context: Context) -> Outcome:
    """Frames, events, or both, on dynamic forces."""
    return force_outcome(context, DYNAMIC, 'inputs', rows=_rows, draw=_draw, conditions=_CONDITIONS)


def _rows(found: Estimates, *, simulated: bool) -> list[Row]:
    rows: list[Row] = []
    for model, by_seed in found.items():
        name = MODELS[model].label
        paper = PAPER_N[model]
        rows += error_rows(name, by_seed, paper, _PLACE, _CONDITIONS, simulated=simulated)
        rate = Value.of(rate_hz(trials) for trials in by_seed.values())
        text = 'distinct forces per second'
        rows.append(Row(f'{name}: rate', rate, PAPER_HZ[model], _PLACE, 'Hz', text, simulated))
    return rows


def _draw(path: Path, found: Estimates, *, simulated: bool) -> Path:
    figure, axes = new_figure(rows=2, width=9.0, height=6.0)
    first = found[OURS][0][0]
    start = first.t_us[0] + 0.3 * (first.t_us[-1] - first.t_us[0])
    length = min(SHOWN_S, 1e-6 * float(first.t_us[-1] - start))
    for ax, models in zip(axes, ((FRAMES, EVENTS), (FGER, OURS)), strict=True):
        curves = {MODELS[model]: found[model][0][0] for model in models}
        plot_forces(ax, first, curves, start, (0.0, length), simulated=simulated)
        ax.set(ylabel='normal force [N]')
        ax.legend(loc='upper right', ncols=3, frameon=False, fontsize=8)
        low, high = ax.get_ylim()
        ax.set_ylim(low, high + 0.22 * (high - low))
    axes[0].set_title(f'{first.name}, {mark(simulated)}', loc='left', fontsize=10)
    axes[-1].set_xlabel('time [s]')
    return save_figure(figure, path)
