# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Frames, events, or both (paper, section IV-C and table II)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mixtac_lab.experiments.harness import Outcome, Row, Value, constant_row, error_rows, rate_hz
from mixtac_lab.experiments.report import COLOURS, mark, new_figure, save_figure
from mixtac_lab.experiments.sizes import DYNAMIC
from mixtac_lab.experiments.training import (
    EVENTS,
    FGER,
    FRAMES,
    LABELS,
    MODELS,
    deviations,
    estimates,
    trial_sets,
)
from mixtac_learning.train.config import OURS

if TYPE_CHECKING:
    from pathlib import Path

    from mixtac_lab.experiments.harness import Context
    from mixtac_lab.experiments.training import Estimates


PAPER = {
    FRAMES: {'mae': 0.06, 'rmse': 0.08},
    EVENTS: {'mae': 0.12, 'rmse': 0.14},
    FGER: {'mae': 0.04, 'rmse': 0.05},
    OURS: {'mae': 0.04, 'rmse': 0.05},
}
"""Errors [N]; ours stands beside the paper's network."""
PAPER_HZ = {FRAMES: 25.0, EVENTS: 500.0, FGER: 500.0, OURS: 500.0}
_PLACE = 'section IV-C, table II'
SHOWN_S = 5.0
"""Length of the stretch in the figure [s]."""


def inputs(context: Context) -> Outcome:
    """Return the errors of frames, events and both on dynamic trials.

    Raises:
        MixtacError: Trials are missing or cannot be used.
    """
    sets = trial_sets(context.sizes, context.bags)
    found = estimates(context, DYNAMIC)
    rows: list[Row] = []
    for model in MODELS[DYNAMIC]:
        name = LABELS[model]
        rows += error_rows(
            name, found[model], PAPER[model], _PLACE, 'dynamic trials', simulated=sets.simulated
        )
        rate = Value.of(rate_hz(trials) for trials in found[model].values())
        text = 'different forces per second'
        paper = PAPER_HZ[model]
        rows.append(Row(f'{name}: rate', rate, paper, _PLACE, 'Hz', text, sets.simulated))
    rows.append(constant_row(found[OURS], 'dynamic trials', simulated=sets.simulated))
    path = _draw(context.figures / 'inputs.png', found, simulated=sets.simulated)
    return Outcome(
        name='inputs',
        title='Frames, events, or both',
        paper='Three models under one protocol on dynamic force profiles: frames only, events'
        ' only, FGER-Net.',
        data=sets.describe(DYNAMIC),
        rows=rows,
        figures={'Forces of the first test trial, 5 s of it': path},
        deviations=(
            *deviations(context.sizes),
            'The events-only network begins each trial at no force, as the others do.',
        ),
    )


def _draw(path: Path, found: Estimates, *, simulated: bool) -> Path:
    figure, axes = new_figure(rows=2, width=9.0, height=6.0)
    first = {model: by_seed[0][0] for model, by_seed in found.items()}
    any_one = first[OURS]
    start = any_one.t_us[0] + 0.3 * (any_one.t_us[-1] - any_one.t_us[0])
    length = min(SHOWN_S, 1e-6 * float(any_one.t_us[-1] - start))
    for ax, models in zip(axes, ((FRAMES, EVENTS), (FGER, OURS)), strict=True):
        for model, colour in (('truth', COLOURS['truth']), *((m, COLOURS[m]) for m in models)):
            each = any_one if model == 'truth' else first[model]
            shown = (each.t_us >= start) & (each.t_us <= start + 1e6 * SHOWN_S)
            t_s = 1e-6 * (each.t_us[shown] - start)
            values = each.known if model == 'truth' else each.force
            label = LABELS.get(model, 'true force' if simulated else 'reference')
            width = 2.2 if model == 'truth' else 1.1
            ax.plot(t_s, values[shown], color=colour, label=label, lw=width, alpha=0.9)
        ax.set(ylabel='normal force [N]', xlim=(0.0, length))
        ax.legend(loc='upper right', ncols=3, frameon=False, fontsize=8)
        low, high = ax.get_ylim()
        ax.set_ylim(low, high + 0.22 * (high - low))
    axes[0].set_title(f'{any_one.name}, {mark(simulated)}', loc='left', fontsize=10)
    axes[-1].set_xlabel('time [s]')
    return save_figure(figure, path)
