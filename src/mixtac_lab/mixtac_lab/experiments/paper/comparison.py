# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The table of vision-based tactile sensors with a row for ours (paper, table III)."""

from __future__ import annotations

from mixtac_lab.experiments.harness import Context, experiment, pooled, rate_hz
from mixtac_lab.experiments.report import Outcome, Row, Value, mark, number, texts, value_text
from mixtac_lab.experiments.sizes import DYNAMIC, FGER
from mixtac_lab.experiments.training import MODELS, Estimates, deviations, estimates, trial_sets
from mixtac_learning.judge.estimators import TrialEstimate
from mixtac_learning.train.config import OURS

OTHERS = (
    ('Insight', 'frames', 40.0, 0.03, 2.0),
    ('ViTacTip', 'frames', 30.0, 0.04, 1.0),
    ('E-BTS', 'events', 500.0, 0.49, 8.0),
    ('GelEvent', 'events', 180.0, 0.80, 16.0),
)
"""Sensor, input, rate [Hz], error [N], range [N], as the paper cites them."""
MIXTAC = (500.0, 0.04, 1.0)
_PLACE = 'section V-B, table III'


@experiment
def comparison(context: Context) -> Outcome:
    """Rate, error and range beside other sensors."""
    sets = trial_sets(context.sizes, context.bags)
    found = estimates(context, DYNAMIC)
    rows = []
    for model in (OURS, FGER):
        values = _figures(found[model])
        for (title, value, unit), paper in zip(values, MIXTAC, strict=True):
            name = f'Mixtac, frames and events, {MODELS[model].label}: {title}'
            rows.append(Row(name, value, paper, _PLACE, unit, 'dynamic trials', sets.simulated))
    for sensor, kind, *numbers in OTHERS:
        nothing = Value.of([])
        for (title, _, unit), paper in zip(values, numbers, strict=True):
            name = f'{sensor}, {kind}: {title}'
            rows.append(Row(name, nothing, paper, _PLACE, unit, 'cited by the paper', False))
    fields = texts('comparison')
    ours = (
        'Our row is of a simulated sensor; the others are of real ones.'
        if sets.simulated
        else 'Our row is of the given recordings.'
    )
    fields['deviations'] = (*deviations(context.sizes), ours, *fields['deviations'])
    return Outcome(
        data=sets.describe(DYNAMIC),
        rows=rows,
        table=_table(found, simulated=sets.simulated),
        **fields,
    )


def _figures(by_seed: dict[int, list[TrialEstimate]]) -> tuple[tuple[str, Value, str], ...]:
    """Return rate, error and largest force with their units."""
    metrics = [pooled(trials) for trials in by_seed.values()]
    return (
        ('rate', Value.of(rate_hz(trials) for trials in by_seed.values()), 'Hz'),
        ('MAE of the normal force', Value.of(each.mae for each in metrics), 'N'),
        ('largest force tested', Value.of(each.peak_truth for each in metrics), 'N'),
    )


def _table(found: Estimates, *, simulated: bool) -> tuple[tuple[str, ...], ...]:
    """Return the paper's table with our rows."""
    lines: list[tuple[str, ...]] = [
        ('sensor', 'input', 'rate [Hz]', 'normal force error [N]', 'range [N]')
    ]
    lines += [(name, kind, *map(number, values)) for name, kind, *values in OTHERS]
    lines.append(('Mixtac (paper)', 'frames and events', *map(number, MIXTAC)))
    for model in (OURS, FGER):
        name = f'{MODELS[model].label}, {mark(simulated)}'
        values = [value_text(value) for _, value, _ in _figures(found[model])]
        lines.append((name, 'frames and events', *values))
    return tuple(lines)
