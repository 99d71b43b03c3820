# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Figures of a model over trials: computed, as tables on the terminal, as plots."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from mixtac_fger.validity import Reason
from mixtac_learning.judge.estimators import TrialEstimate
from mixtac_learning.judge.metrics import (
    ROLLING_S,
    across_errors,
    fast_error,
    frame_jump,
    hold_noise,
    lag_ms,
    measure,
    peak_error,
    rolling_errors,
)
from mixtac_learning.trials.trial import DatasetError
from mixtac_node.files import replacing

INTERVALS = {'coverage_68': 1.0, 'coverage_95': 1.96}
"""Half widths of the intervals in standard deviations: 68.3 % and 95 % of a Gaussian."""


def coverage_figures(estimates: Sequence[TrialEstimate]) -> dict[str, float]:
    """Return the part of all windows within each of `INTERVALS`, and the mean deviation [N].

    Empty for models without an uncertainty output. Zero width covers a zero error.

    Args:
        estimates: Estimates, at least one.
    """
    pairs = [(np.abs(e.force - e.known), e.deviation) for e in estimates if e.deviation is not None]
    if len(pairs) < len(estimates):
        return {}
    error = np.concatenate([each for each, _ in pairs])
    deviation = np.concatenate([each for _, each in pairs])
    covered = {name: np.mean(error <= width * deviation) for name, width in INTERVALS.items()}
    figures = covered | {'mean_deviation': deviation.mean()}
    return {name: round(float(value), 4) for name, value in figures.items()}


ALL = 'all'


def by_profile(
    estimates: Sequence[TrialEstimate], scales: Mapping[str, float] | None = None
) -> dict[str, dict[str, Any]]:
    """Return the figures of each profile, and those over all under `all`.

    Args:
        estimates: Estimates, at least one.
        scales: Scale of each sensor from another trial, by `TrialEstimate.device`; None for none.
    """
    profiles = list(dict.fromkeys(each.profile for each in estimates))
    rows = {
        profile: summarise([each for each in estimates if each.profile == profile], scales)
        for profile in profiles
    }
    return rows | {ALL: summarise(estimates, scales)}


def summarise(
    estimates: Sequence[TrialEstimate], scales: Mapping[str, float] | None = None
) -> dict[str, Any]:
    """Return the figures over trials; forces in N, ratios without unit.

    Returns:
        `trials`; of all windows together what `Metrics` holds; the means over trials of
        `peak_error` and of `fast_mae` with `fast_constant_mae`, and of the rolling error in the
        first and last half second and at its worst, of `frame_jump`, `hold_noise` and `lag_ms`;
        `reference_mae` against the measured reference where the true force is what counts
        otherwise; `frames_only_mae` where the model has such an output; what `coverage_figures`
        and `across_figures` give; with the scales `calibrated_mae`, `calibrated_rmse`,
        `calibrated_hold_noise` and `calibrated_` before what `coverage_figures` gives.
    """
    known = np.concatenate([each.known for each in estimates])
    pooled = measure(known, np.concatenate([each.force for each in estimates]))
    figures: dict[str, Any] = {'trials': len(estimates)} | pooled.to_dict()
    figures |= _over_time(estimates) | coverage_figures(estimates) | across_figures(estimates)
    measured = [np.abs(e.force - e.reference) for e in estimates if e.reference is not None]
    framed = [np.abs(e.frames_only - e.known) for e in estimates if e.frames_only is not None]
    for name, errors in (('reference_mae', measured), ('frames_only_mae', framed)):
        if errors:
            figures[name] = _rounded(float(np.concatenate(errors).mean()))
    if scales is not None:
        scaled = [each.scaled(scales.get(each.device, 1.0)) for each in estimates]
        after = measure(known, np.concatenate([each.force for each in scaled]))
        found = {'mae': _rounded(after.mae), 'rmse': _rounded(after.rmse)}
        noise = np.array([hold_noise(e.known, e.force, _interval_s(e)) for e in scaled])
        if not np.isnan(noise).all():
            found['hold_noise'] = _rounded(float(np.nanmean(noise)))
        found |= coverage_figures(scaled)
        figures |= {f'calibrated_{name}': value for name, value in found.items()}
    return figures


def across_figures(estimates: Sequence[TrialEstimate]) -> dict[str, float]:
    """Return the errors across the normal over all windows; none where they are not known.

    Returns:
        `sideways_mae` per axis [N], `torque_mae_nmm`, and the mean sizes of what was estimated,
        which is what no estimate at all would err by.
    """
    pairs = [
        (each.across, each.known_across)
        for each in estimates
        if each.across is not None and each.known_across is not None
    ]
    if not pairs:
        return {}
    found, known = (np.concatenate(each) for each in zip(*pairs, strict=True))
    names = ('sideways_mae', 'sideways_size', 'torque_mae_nmm', 'torque_size_nmm')
    return dict(zip(names, map(_rounded, across_errors(found, known)), strict=True))


def _over_time(estimates: Sequence[TrialEstimate]) -> dict[str, float]:
    rows = []
    for each in estimates:
        interval_s = _interval_s(each)
        fast, fast_constant = fast_error(each.known, each.force, interval_s)
        rolling = rolling_errors(each.known, each.force, interval_s)
        peak = peak_error(each.known, each.force, interval_s)
        noise = hold_noise(each.known, each.force, interval_s)
        late = lag_ms(each.known, each.force, interval_s)
        jump = np.nan if each.corrected is None else frame_jump(each.force, each.corrected)
        ends = rolling[0], rolling[-1], rolling.max()
        rows.append((peak, fast, fast_constant, *ends, jump, noise, late))
    names = (
        'peak_error',
        'fast_mae',
        'fast_constant_mae',
        'rolling_first_mae',
        'rolling_last_mae',
        'rolling_worst_mae',
        'frame_jump',
        'hold_noise',
        'lag_ms',
    )
    table = np.array(rows, np.float64)
    return {
        name: _rounded(float(np.nanmean(column)))
        for name, column in zip(names, table.T, strict=True)
        if not np.isnan(column).all()
    }


def _interval_s(estimate: TrialEstimate) -> float:
    steps = np.diff(estimate.t_us)
    return float(np.median(steps)) / 1e6 if len(steps) else 0.002


def _rounded(value: float) -> float:
    return round(value, 4)


COLUMNS = (
    'mae',
    'sideways_mae',
    'sideways_size',
    'sideways_mae_with_gain',
    'torque_mae_nmm',
    'torque_size_nmm',
    'rmse',
    'r2',
    'calibrated_mae',
    'frames_only_mae',
    'constant_mae',
    'reference_mae',
    'peak_error',
    'fast_mae',
    'rolling_worst_mae',
    'frame_jump',
    'hold_noise',
    'lag_ms',
    'coverage_68',
    'coverage_95',
    'calibrated_hold_noise',
    'calibrated_coverage_68',
    'calibrated_coverage_95',
)
"""Figures in the order shown; those that no row has are left out."""
_FIGURE = len('-0.000')
_BORDERS = 4
"""Characters of a table's edges and of the space about its first column."""


def show_figures(console: Console, title: str, figures: Mapping[str, Mapping[str, Any]]) -> None:
    """Print figures, one row per profile; in several tables where the terminal is narrow."""
    shown = [name for name in COLUMNS if any(name in row for row in figures.values())]
    for names in _fitting(shown, console.width - max(map(len, ['profile', *figures]))):
        table = Table(title=title, title_justify='left')
        table.add_column('profile', no_wrap=True)
        for name in names:
            table.add_column(name.replace('_', ' '), justify='right', width=_width(name))
        for profile, row in figures.items():
            table.add_row(profile, *(f'{row[c]:.3f}' if c in row else '-' for c in names))
        console.print(table)


def _width(name: str) -> int:
    """Return the characters that a column needs: its longest word, or a figure."""
    return max(_FIGURE, *map(len, name.split('_')))


def _fitting(names: Sequence[str], width: int) -> Iterator[list[str]]:
    """Yield the columns in parts of which each fits into a width, at least one at a time."""
    part: list[str] = []
    left = width - _BORDERS
    for name in names:
        needed = _width(name) + _BORDERS - 1
        if part and needed > left:
            yield part
            part, left = [], width - _BORDERS
        part.append(name)
        left -= needed
    if part:
        yield part


def show_skipped(console: Console, skipped: Mapping[str, str]) -> None:
    """Print which trials were left out and why."""
    for name, reason in skipped.items():
        console.print(f'left out {name}: {reason}', style='yellow', highlight=False)


_ROWS = 4


def draw_trials(path: Path, title: str, estimates: Sequence[TrialEstimate]) -> None:
    """Draw force over time and the rolling error, the first trials of each profile.

    Args:
        path: Picture to write; its folder is made if need be.
        title: Above the picture.
        estimates: Estimates.
    """
    from matplotlib.figure import Figure

    firsts = {each.profile: each for each in reversed(estimates)}
    chosen = list(reversed(firsts.values()))[:_ROWS]
    figure = Figure(figsize=(11.0, 2.4 * len(chosen) + 0.4), layout='constrained')
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
        rolling = rolling_errors(each.known, each.force, _interval_s(each))
        right.step(ROLLING_S * np.arange(len(rolling)), rolling, where='post')
        right.set(title='rolling MAE', xlabel='time [s]', ylabel='N', ylim=(0, None))
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


SERIES = {
    'trial': '%s',
    'stamp': '%d',
    'force': '%.6f',
    'deviation': '%.6f',
    'valid': '%d',
    'reason': '%s',
    'reference': '%.6f',
}
"""Columns of a series and how csv shows them."""
SERIES_UNITS = {'stamp': 'us, camera clock', 'force': 'N', 'deviation': 'N', 'reference': 'N'}
SERIES_SUFFIXES = ('.csv', '.npz')


def check_series(path: Path) -> None:
    """Check the name of a file for `write_series`.

    Raises:
        DatasetError: Its suffix is another.
    """
    if path.suffix not in SERIES_SUFFIXES:
        raise DatasetError(
            f'{path}: a series is written to {" or ".join(SERIES_SUFFIXES)}',
            remedy='name it forces.csv or forces.npz',
        )


def write_series(path: Path, estimates: Sequence[TrialEstimate]) -> None:
    """Write forces over time, a row or an element per window.

    Columns: name of the trial; end of the window, camera clock [us]; force [N]; its standard
    deviation [N], NaN from a model that gives none; whether the force can be trusted, and why not
    by name; the force it is judged by [N]. A model without checks counts as trusted.

    Args:
        path: .csv or .npz file.
        estimates: Estimates.

    Raises:
        DatasetError: The suffix is another.
        FileError: It cannot be written.
    """
    check_series(path)
    columns: dict[str, Any] = {
        name: np.concatenate([_series(e)[name] for e in estimates]) for name in SERIES
    }
    with replacing(path) as scratch:
        if path.suffix == '.npz':
            with scratch.open('wb') as file:
                np.savez_compressed(file, **columns)
            return
        headings = (
            f'"{name} [{SERIES_UNITS[name]}]"' if name in SERIES_UNITS else name for name in SERIES
        )
        form = ','.join(SERIES.values()) + '\n'
        with scratch.open('w', encoding='utf-8') as text:
            text.write(','.join(headings) + '\n')
            rows = zip(*(column.tolist() for column in columns.values()), strict=True)
            text.writelines(form % row for row in rows)


def _series(estimate: TrialEstimate) -> dict[str, Any]:
    count = len(estimate.t_us)
    reasons = np.zeros(count, np.uint8) if estimate.reasons is None else estimate.reasons
    nothing = np.full(count, np.nan)
    return {
        'trial': np.full(count, estimate.name),
        'stamp': estimate.t_us,
        'force': estimate.force,
        'deviation': nothing if estimate.deviation is None else estimate.deviation,
        'valid': reasons == Reason.TRUSTED,
        'reason': np.array([Reason(each).name for each in Reason])[reasons],
        'reference': estimate.known,
    }
