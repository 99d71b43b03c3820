# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The picture of an alignment: both streams before and after, the taps close up, the residuals."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes

    from mixtac_alignment.clock_fit import ClockFit
    from mixtac_bringup.align.bag_recording import BagRecording

EVENTS, FORCE, ANCHOR = '#5a5a5a', '#1f4e8c', '#c0392b'
CLOSE_S = 0.08


def draw_alignment(path: Path, recording: BagRecording, fit: ClockFit, title: str) -> None:
    """Save the figure of an alignment.

    Args:
        path: File to write; its suffix gives the format.
        recording: What was aligned.
        fit: The clock map.
        title: Title.
    """
    import matplotlib as mpl

    mpl.use('Agg')
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(3, 2, figsize=(11.0, 8.5), layout='constrained')
    figure.suptitle(f'{title}: {fit.method}, {fit.summary()}', fontsize=9)
    for axis in axes.flat:
        axis.spines[['top', 'right']].set_visible(False)
    _whole(axes[0, 0], recording, fit, aligned=False)
    _whole(axes[0, 1], recording, fit, aligned=True)
    _close(axes[1, 0], recording, fit, 0)
    _close(axes[1, 1], recording, fit, -1)
    _residuals(axes[2, 0], fit)
    _uncertainty(axes[2, 1], recording, fit)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def _streams(
    axis: Axes,
    recording: BagRecording,
    fit: ClockFit,
    start_s: float,
    end_s: float,
    *,
    aligned: bool,
) -> None:
    """Draw event rate and force from start to end, in seconds since the first event."""
    counts = recording.counts
    t = (np.arange(len(counts.counts)) + 0.5) * counts.width_us * 1e-6
    shown = (t >= start_s) & (t <= end_s)
    axis.plot(t[shown], counts.counts[shown] / counts.width_us, color=EVENTS, lw=0.6)
    axis.set_ylabel('event rate [Mev/s]', color=EVENTS)
    if aligned:
        force_t = (fit.to_camera(recording.force_t_s) - counts.start_us) * 1e-6
    else:
        force_t = recording.force_t_s - counts.start_us * 1e-6
        if abs(force_t[0]) > 60.0:
            force_t = recording.force_t_s - recording.force_t_s[0]
    shown = (force_t >= start_s) & (force_t <= end_s)
    force = axis.twinx()
    force.spines['top'].set_visible(False)
    force.plot(force_t[shown], recording.force[shown], color=FORCE, lw=0.9)
    force.set_ylabel('force [N]', color=FORCE)


def _whole(axis: Axes, recording: BagRecording, fit: ClockFit, *, aligned: bool) -> None:
    end_s = len(recording.counts.counts) * recording.counts.width_us * 1e-6
    _streams(axis, recording, fit, -5.0, end_s + 5.0, aligned=aligned)
    axis.set_title(
        'after: both on the camera clock' if aligned else 'before: each on its own clock'
    )
    axis.set_xlabel('time since the first event [s]')
    if aligned:
        _anchors(axis, recording, fit)


def _close(axis: Axes, recording: BagRecording, fit: ClockFit, which: int) -> None:
    at_s = (fit.anchors[which].camera_us - recording.counts.start_us) * 1e-6
    _streams(axis, recording, fit, at_s - CLOSE_S, at_s + CLOSE_S, aligned=True)
    _anchors(axis, recording, fit)
    axis.set_xlim(at_s - CLOSE_S, at_s + CLOSE_S)
    axis.set_title('first anchor' if which == 0 else 'last anchor')
    axis.set_xlabel('time since the first event [s]')


def _anchors(axis: Axes, recording: BagRecording, fit: ClockFit) -> None:
    for anchor in fit.anchors:
        at_s = (anchor.camera_us - recording.counts.start_us) * 1e-6
        axis.axvline(at_s, color=ANCHOR, lw=0.8, ls='--')


def _residuals(axis: Axes, fit: ClockFit) -> None:
    first = fit.anchors[0].camera_us
    t = [(anchor.camera_us - first) * 1e-6 for anchor in fit.anchors]
    std = [1e3 * anchor.std_s for anchor in fit.anchors]
    axis.errorbar(t, 1e3 * fit.residuals_s, yerr=std, fmt='o', color=ANCHOR, capsize=3)
    axis.axhline(0.0, color=EVENTS, lw=0.6)
    axis.set_title('anchors less the map, with their standard deviation')
    axis.set_xlabel('time since the first anchor [s]')
    axis.set_ylabel('residual [ms]')


def _uncertainty(axis: Axes, recording: BagRecording, fit: ClockFit) -> None:
    counts = recording.counts
    t_s = np.linspace(0.0, len(counts.counts) * counts.width_us * 1e-6, 100)
    half = 1.96e3 * fit.std_at(counts.start_us + np.rint(t_s * 1e6).astype(np.int64))
    axis.fill_between(t_s, -half, half, color=FORCE, alpha=0.25, lw=0)
    axis.set_title('95 % interval of the map')
    axis.set_xlabel('time since the first event [s]')
    axis.set_ylabel('time error [ms]')
