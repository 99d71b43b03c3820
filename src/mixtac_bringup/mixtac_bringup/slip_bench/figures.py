# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Figures of slip trials and of the detectors' curves."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from mixtac_bringup.slip_bench.kept_trials import CURVE_MS
from mixtac_bringup.slip_bench.trial import KNOCK_S
from mixtac_events.arrays import Events
from mixtac_sim.array_geometry import HEIGHT, WIDTH

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from mixtac_bringup.slip_bench.closed_loop import LoopRecord
    from mixtac_bringup.slip_bench.trial import TrialResult

SPAN_MS = (-10.0, 80.0)
KEY_MS = (-5.0, 0.0)
"""Begins of the first two key frames from the onset [ms]; the last is where the object stands."""
FRAME_MS = 5.0
"""Time over which a key frame collects events [ms]."""


def draw_trial(path: Path, result: TrialResult, record: LoopRecord) -> None:
    """Draw displacement, force, counts and three key frames of a trial.

    Args:
        path: Where the figure goes.
        result: What came of the trial.
        record: What happened in it.
    """
    figure = Figure(figsize=(9.0, 7.0), layout='constrained')
    grid = figure.add_gridspec(3, 3)
    t_ms = 1e-3 * record.t_us - 1e3 * KNOCK_S
    seen = (t_ms >= SPAN_MS[0]) & (t_ms <= SPAN_MS[1])
    start = record.object_mm[np.searchsorted(t_ms, 0.0)]
    place = figure.add_subplot(grid[0, :2])
    place.plot(t_ms[seen], record.object_mm[seen] - start)
    place.set(ylabel='object [mm], downwards', title=f'{result.name}, simulated')
    _counts(figure.add_subplot(grid[1, :2]), record)
    force = figure.add_subplot(grid[0, 2])
    force.plot(t_ms[seen], record.normal_n[seen])
    force.set(ylabel='normal force [N]')
    advance = figure.add_subplot(grid[1, 2])
    advance.plot(t_ms[seen], record.advance_mm[seen])
    advance.set(xlabel='after the blow [ms]', ylabel='fingertip [mm]')
    last = result.arrest_ms if np.isfinite(result.arrest_ms) else SPAN_MS[1]
    for k, at in enumerate((*KEY_MS, last)):
        _key_frame(figure.add_subplot(grid[2, k]), record, at)
    _save(figure, path)


def draw_objects(
    path: Path, curves: Mapping[str, Sequence[NDArray[np.float64]]], paper_mm: Mapping[str, float]
) -> None:
    """Draw the way of every object after the blow, one panel per kind.

    Args:
        path: Where the figure goes.
        curves: Place at `CURVE_MS` of each trial [91] [mm], by kind.
        paper_mm: Mean displacement in the paper [mm], by kind.
    """
    figure = Figure(figsize=(4.0 * len(curves), 3.4), layout='constrained')
    axes = figure.subplots(1, len(curves), squeeze=False)[0]
    for ax, (name, ways) in zip(axes, curves.items(), strict=True):
        for way in ways:
            ax.plot(CURVE_MS, way, color='tab:blue', alpha=0.3, linewidth=0.8)
        ax.plot(CURVE_MS, np.mean(ways, axis=0), color='tab:blue', label='mean')
        ax.axhline(paper_mm[name], color='tab:gray', linestyle=':', label="the paper's mean")
        ax.set(xlabel='after the blow [ms]', title=f'{name}, {len(ways)} trials, simulated')
        ax.legend()
    axes[0].set_ylabel('displacement [mm]')
    _save(figure, path)


def draw_curves(path: Path, curves: Mapping[str, Any]) -> None:
    """Draw latency against false alarms of both detectors, one panel per speed.

    Args:
        path: Where the figure goes.
        curves: Of `mixtac_bringup.slip_bench.detectors.curves`.
    """
    figure = Figure(figsize=(4.0 * len(curves), 3.6), layout='constrained')
    axes = figure.subplots(1, len(curves), squeeze=False)[0]
    for ax, (speed, both) in zip(axes, curves.items(), strict=True):
        for name, curve in both.items():
            late = [np.nan if v is None else v for v in curve['latency_ms']]
            (line,) = ax.plot(np.array(curve['false_alarms_per_min']) + 0.01, late, label=name)
            shipped = curve['shipped']
            if shipped['latency_p50_ms'] is not None:
                at = shipped['false_alarms_per_min'] + 0.01, shipped['latency_p50_ms']
                ax.plot(*at, 'o', color=line.get_color(), label=f'{name}, shipped')
        ax.set(xscale='log', xlabel='false alarms per minute + 0.01', ylabel='median latency [ms]')
        ax.set_title(f'{speed.replace("_mm_s", " mm/s")}, simulated')
        ax.legend()
    _save(figure, path)


def _counts(ax: Axes, record: LoopRecord) -> None:
    t_ms = 1e-3 * np.array([step.end_us for step in record.steps]) - 1e3 * KNOCK_S
    seen = (t_ms >= SPAN_MS[0]) & (t_ms <= SPAN_MS[1])
    ax.step(t_ms[seen], np.array([s.count for s in record.steps])[seen], label='events per ms')
    threshold = np.array([s.threshold for s in record.steps])
    ax.step(t_ms[seen], threshold[seen], label='threshold of the count law')
    ax.set(xlabel='after the blow [ms]')
    ax.legend()


def _key_frame(ax: Axes, record: LoopRecord, at_ms: float) -> None:
    """Show the events of a few milliseconds."""
    first = 1e6 * KNOCK_S + 1e3 * at_ms
    events = Events.concatenate(record.events)
    chosen = events[
        int(np.searchsorted(events.t, first)) : int(
            np.searchsorted(events.t, first + 1e3 * FRAME_MS)
        )
    ]
    ax.imshow(_picture(chosen), cmap='gray', vmin=-1, vmax=1)
    ax.set(xticks=[], yticks=[], title=f'{at_ms:.0f} to {at_ms + FRAME_MS:.0f} ms')


def _picture(events: Events) -> NDArray[np.float64]:
    """Return ON less OFF events per pixel [260, 346]."""
    picture = np.zeros((HEIGHT, WIDTH))
    np.add.at(picture, (events.y, events.x), np.where(events.polarity, 1.0, -1.0))
    return picture


def _save(figure: Figure, path: Path) -> None:
    FigureCanvasAgg(figure)
    figure.savefig(path, dpi=120)
