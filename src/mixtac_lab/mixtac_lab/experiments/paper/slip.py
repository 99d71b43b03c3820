# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Slip control in closed loop with cup, box and ball, simulated (paper, section IV-F).

`slip` is the experiment of the report; `grasps` runs trials with other seeds and settings of your
choice, and draws a typical one of each object.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mixtac_cli.figures import new_axes, save_figure
from mixtac_events.arrays import Events
from mixtac_lab.experiments.harness import Context, experiment
from mixtac_lab.experiments.report import PAPER, Outcome, Row, Value, mark, texts
from mixtac_lab.experiments.sizes import PRESET
from mixtac_lab.experiments.training import MODELS
from mixtac_lab.slip.loop import LoopRecord
from mixtac_lab.slip.trials import (
    COURSE_MS,
    KNOCK_S,
    TrialPlan,
    trial_piece,
)
from mixtac_learning.train.config import OURS
from mixtac_sim.grids import HEIGHT, WIDTH

PAPER_MM = {'cup': 0.90, 'box': 0.71, 'ball': 10.03}
"""Mean displacement in the paper [mm]."""
PAPER_MS, PAPER_BOX_MM = 13.0, 0.32
"""Duration and displacement of the paper's one box trial."""
FIRST_SEED = 86_000
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
    path = _draw(context.figures / 'slip.png', results)
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


SPAN_MS = (-10.0, 80.0)
KEY_MS = (-5.0, 0.0)
"""Starts of the first two key frames from the onset [ms]; the last one shows the object at rest."""
FRAME_MS = 5.0
"""Time in which a key frame collects events [ms]."""


def draw_trial(path: Path, result: Mapping[str, Any], record: LoopRecord) -> None:
    """Draw displacement, force, counts and three key frames of a trial.

    Args:
        path: Image file.
        result: Result of the trial.
        record: Course of the trial.
    """
    figure = Figure(figsize=(9.0, 7.0), layout='constrained')
    key_frames = ['first', 'second', 'last']
    axes: dict[str, Axes] = figure.subplot_mosaic(
        [['object', 'object', 'force'], ['counts', 'counts', 'advance'], key_frames]
    )
    t_ms = 1e-3 * record.t_us - 1e3 * KNOCK_S
    seen = (t_ms >= SPAN_MS[0]) & (t_ms <= SPAN_MS[1])
    start = record.object_mm[np.searchsorted(t_ms, 0.0)]
    axes['object'].plot(t_ms[seen], record.object_mm[seen] - start)
    axes['object'].set(ylabel='object [mm], downwards', title=f'{result["name"]}, simulated')
    axes['force'].plot(t_ms[seen], record.normal_n[seen])
    axes['force'].set(ylabel='normal force [N]')
    axes['advance'].plot(t_ms[seen], record.advance_mm[seen])
    axes['advance'].set(xlabel='after the knock [ms]', ylabel='fingertip [mm]')
    _draw_counts(axes['counts'], record)
    last = SPAN_MS[1] if result['arrest_ms'] is None else result['arrest_ms']
    for name, at_ms in zip(key_frames, (*KEY_MS, last), strict=True):
        _draw_key_frame(axes[name], record, at_ms)
    save_figure(figure, path)


def _draw_counts(ax: Axes, record: LoopRecord) -> None:
    t_ms = 1e-3 * np.array([step.end_us for step in record.steps]) - 1e3 * KNOCK_S
    seen = (t_ms >= SPAN_MS[0]) & (t_ms <= SPAN_MS[1])
    for label, values in (
        ('events per ms', [step.count for step in record.steps]),
        ('threshold of the count law', [step.threshold for step in record.steps]),
    ):
        ax.step(t_ms[seen], np.array(values)[seen], label=label)
    ax.set(xlabel='after the knock [ms]')
    ax.legend()


def _draw_key_frame(ax: Axes, record: LoopRecord, at_ms: float) -> None:
    """Show ON minus OFF events per pixel in a few milliseconds."""
    first = round(1e6 * KNOCK_S + 1e3 * at_ms)
    events = Events.concatenate(record.events).between(first, first + round(1e3 * FRAME_MS))
    picture = np.zeros((HEIGHT, WIDTH))
    np.add.at(picture, (events.y, events.x), np.where(events.polarity, 1.0, -1.0))
    ax.imshow(picture, cmap='gray', vmin=-1, vmax=1)
    ax.set(xticks=[], yticks=[], title=f'{at_ms:.0f} to {at_ms + FRAME_MS:.0f} ms')
