# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Slip control in closed loop with cup, box and ball, simulated (paper, section IV-F)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixtac_learning.experiments.harness import Context, experiment
from mixtac_learning.experiments.report import Outcome, Row, Value, mark, texts
from mixtac_learning.experiments.sizes import PRESET
from mixtac_learning.experiments.slip_trials import COURSE_MS, TrialPlan, trial_piece
from mixtac_learning.experiments.training import MODELS
from mixtac_learning.judge.report import PAPER, new_axes, save_figure
from mixtac_learning.train.config import OURS

PAPER_MM = {'cup': 0.90, 'box': 0.71, 'ball': 10.03}
"""Mean displacement in the paper [mm]."""
PAPER_MS = 13.0
"""Duration of the paper's one box trial [ms]."""
PAPER_BOX_MM = 0.32
"""Displacement of that trial [mm]."""
FIRST_SEED = 86_000
"""Seed of the first trial."""
MARGIN = 1.05
"""Ratio of the grasp force to the smallest force that holds the object."""
_PLACE = 'section IV-F, Fig. 8'
_COLOUR = MODELS[OURS].colour
Results = dict[str, list[dict[str, Any]]]


@experiment
def slip(context: Context) -> Outcome:
    """Objects that are knocked, in closed loop."""
    fields = texts('slip')
    if context.bags is not None:
        return Outcome(
            **fields | {'deviations': ()},
            data='none',
            skipped='A closed loop cannot be replayed from bags: the motion of the arm changes what'
            ' is recorded. `mixtac up slip` runs it; without --bags this experiment simulates it.',
        )
    grasped = context.sizes.grasps
    plans = [
        TrialPlan(name, FIRST_SEED + 1000 * at + k, margin=MARGIN, preset=PRESET)  # type: ignore[arg-type]
        for at, (name, count) in enumerate(grasped.items())
        for k in range(count)
    ]
    found = context.run('slip', [trial_piece(plan) for plan in plans])
    results: Results = {name: [] for name in grasped}
    for plan, result in zip(plans, found, strict=True):
        results[plan.name].append(result)
    path = _draw(context.figure('slip'), results)
    trials = ', '.join(f'{count} x {name}' for name, count in grasped.items())
    return Outcome(
        data=f'virtual sensor, preset {PRESET}, and simulated grasp; {trials}; every trial draws'
        f' object, sensor and knock (seeds from {FIRST_SEED}); grasp force {MARGIN:g} times the'
        ' smallest force that holds',
        rows=_rows(results),
        figures={'Displacement of the boxes, and of all objects; diamonds: the paper': path},
        **fields,
    )


def _rows(results: Results) -> list[Row]:
    rows = []
    for name, trials in results.items():
        text = f'{len(trials)} trials; spread over trials'
        slip_mm, held, open_held, detection_ms = (
            Value.of(_values(trials, key), 'trials')
            for key in ('slip_mm', 'held', 'open_held', 'detection_ms')
        )
        rows += [
            Row(f'{name}: mean displacement', slip_mm, PAPER_MM[name], _PLACE, 'mm', text),
            Row(f'{name}: share held', held, 1.0, _PLACE, '', text),
            Row(f'{name}: share held without control', open_held, 0.0, _PLACE, '', text),
            Row(f'{name}: onset to detection', detection_ms, None, '', 'ms', text),
        ]
        if name == 'box':
            one = f'{text}; paper: one trial'
            middle, time, bound = (
                _median(trials, key) for key in ('slip_mm', 'arrest_ms', 'floor_mm')
            )
            rows += [
                Row('box: median displacement', middle, PAPER_BOX_MM, _PLACE, 'mm', one),
                Row('box: median time from the knock to rest', time, PAPER_MS, _PLACE, 'ms', one),
                Row('box: median lower bound of the displacement', bound, None, '', 'mm', text),
            ]
    return rows


def _values(trials: Sequence[Mapping[str, Any]], key: str) -> NDArray[np.float64]:
    """Return a result of each trial; one that does not exist is NaN."""
    return np.array([trial[key] for trial in trials], np.float64)


def _median(trials: Sequence[Mapping[str, Any]], key: str) -> Value:
    values = _values(trials, key)
    found = Value.of(values, 'trials')
    return replace(found, mean=float(np.nanmedian(values))) if found.count else found


def _draw(path: Path, results: Results) -> Path:
    figure, (left, right) = new_axes(columns=2, width=9.0, height=3.8)
    for k, trial in enumerate(results.get('box', [])):
        left.plot(COURSE_MS, trial['course_mm'], color=_COLOUR, lw=1.8 if k == 0 else 0.5)
    left.plot(PAPER_MS, PAPER_BOX_MM, 'D', color=PAPER, label='paper, one trial')
    left.set(xlabel='time from the knock [ms]', ylabel='displacement [mm]')
    left.set_title(f'box, {mark(simulated=True)}', fontsize=10)
    left.legend(frameon=False, fontsize=8)
    random = np.random.default_rng(0)
    for k, (name, trials) in enumerate(results.items()):
        values = [trial['slip_mm'] for trial in trials]
        places = k + random.uniform(-0.15, 0.15, len(values))
        right.plot(places, values, 'o', color=_COLOUR, ms=4, alpha=0.6)
        right.hlines(np.mean(values), k - 0.25, k + 0.25, _COLOUR, lw=2)
        right.plot(k + 0.32, PAPER_MM[name], 'D', color=PAPER)
    right.set_xticks(range(len(results)), list(results))
    right.set(ylabel='displacement [mm]', yscale='log', xlim=(-0.6, len(results) - 0.4))
    for which in (right.yaxis.set_major_formatter, right.yaxis.set_minor_formatter):
        which('{x:.2g}')
    right.tick_params(axis='y', which='both', labelsize=8)
    right.set_title(f'all objects, means as lines, {mark(simulated=True)}', fontsize=10)
    return save_figure(figure, path)
