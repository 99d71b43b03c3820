# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Pictures of what a model does on trials."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mixtac_fger.judge.time_errors import ROLLING_S, rolling_errors

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from mixtac_fger.judge.trial_estimate import TrialEstimate

_ROWS = 4


def draw_trials(path: Path, title: str, estimates: Sequence[TrialEstimate]) -> None:
    """Draw force over time and the rolling error, the first trials of each profile.

    Args:
        path: Picture to write; its folder is made if need be.
        title: Above the picture.
        estimates: Estimates.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    firsts = {each.profile: each for each in reversed(estimates)}
    chosen = list(reversed(firsts.values()))[:_ROWS]
    figure = Figure(figsize=(11.0, 2.4 * len(chosen) + 0.4), layout='constrained')
    FigureCanvasAgg(figure)
    figure.suptitle(title)
    panels = figure.subplots(len(chosen), 2, squeeze=False, width_ratios=(3, 1))
    for (left, right), each in zip(panels, chosen, strict=True):
        seconds = (each.t_us - each.t_us[0]) / 1e6
        left.plot(seconds, each.known, 'k', lw=1.2, label='known force')
        if each.frames_only is not None:
            left.plot(seconds, each.frames_only, 'tab:orange', lw=0.6, label='frames only')
        left.plot(seconds, each.force, 'tab:green', lw=0.8, label='estimate')
        left.set(title=f'{each.profile}: {each.name}', xlabel='time [s]', ylabel='force [N]')
        left.legend(fontsize='x-small')
        rolling = rolling_errors(each.known, each.force, 0.002)
        right.step(ROLLING_S * np.arange(len(rolling)), rolling, where='post')
        right.set(title='rolling MAE', xlabel='time [s]', ylabel='N', ylim=(0, None))
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
