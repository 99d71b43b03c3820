# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What holds a knocked object: trials of slip control in closed loop, simulated, in lock-step.

The same seeds are run with both the press and the answer to slip, with either alone, and by the law
of the paper. `--margin` is the grasp relative to the smallest force that holds.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any

import numpy as np
import typer
from joblib import Parallel, delayed
from rich.console import Console

from mixtac.figures import make_table
from mixtac.options import JsonFile
from mixtac_core.node.files import write_json
from mixtac_learning.experiments.slip import TrialPlan, run_trial
from mixtac_slip_control.errors import SlipControlError
from mixtac_slip_control.parameters import SlipControlParameters

OBJECTS = ('box', 'cup', 'ball')
WAYS: dict[str, dict[str, Any]] = {
    'both': {},
    'press': {'slip_force': 0.01},
    'answer': {'grip_margin': 1.0},
    'paper': {'law': 'paper'},
}
"""Parameters of slip control that differ from the defaults, by the name of the way."""


def trial(plan: TrialPlan) -> dict[str, Any]:
    """Return the result of a trial; `refused` says why slip control was not enabled."""
    try:
        return run_trial(plan)[0]
    except SlipControlError as error:
        return {'name': plan.name, 'seed': plan.seed, 'refused': str(error)}


def summary(trials: list[dict[str, Any]]) -> dict[str, Any]:
    """Return counts and medians of trials; those that were refused count apart."""
    ran = [each for each in trials if 'refused' not in each]
    found = {'trials': len(ran), 'refused': len(trials) - len(ran)}
    if not ran:
        return found
    slip_mm = [each['slip_mm'] for each in ran]
    detection_ms = [each['detection_ms'] for each in ran if each['detection_ms'] is not None]
    return found | {
        'held': sum(each['held'] for each in ran),
        'open_held': sum(each['open_held'] for each in ran),
        'slip_mm': float(np.median(slip_mm)),
        'largest_slip_mm': max(slip_mm),
        'peak_n': max(each['peak_n'] for each in ran),
        'detection_ms': float(np.median(detection_ms)) if detection_ms else None,
        'missed_detections': len(ran) - len(detection_ms),
        'false_alarms': sum(each['false_alarms'] for each in ran),
        'limit_violations': sum(each['limit_violations'] for each in ran),
        'stops': sum(bool(each['stopped']) for each in ran),
    }


def slip(
    trials: Annotated[int, typer.Option(min=1, help='Trials per way.')] = 6,
    margin: Annotated[float, typer.Option(min=1.0, max=5.0, help='Grasp over the least.')] = 1.05,
    knock: Annotated[float, typer.Option(min=0.0, max=500.0, help='Knock (mm/s).')] = 50.0,
    seed: Annotated[int, typer.Option(min=0, help='Seed of the first trial.')] = 900,
    preset: Annotated[str, typer.Option(help='Difficulty of the sensor.')] = 'paper_like',
    jobs: Annotated[int, typer.Option(min=1, help='Trials at once.')] = 1,
    json: JsonFile = None,
) -> None:
    """Knock objects in a simulated grasp: press and answer, either alone, the law of the paper."""
    base = SlipControlParameters()
    plans = {
        way: [
            TrialPlan(
                OBJECTS[number % len(OBJECTS)],
                seed + number,
                margin,
                knock,
                preset=preset,
                settings=replace(base, **changed),
            )
            for number in range(trials)
        ]
        for way, changed in WAYS.items()
    }
    flat = [plan for each in plans.values() for plan in each]
    results = iter(Parallel(n_jobs=jobs)(delayed(trial)(plan) for plan in flat))
    found = {way: [next(results) for _ in each] for way, each in plans.items()}
    report = {way: summary(each) for way, each in found.items()}
    names = ('trials', 'held', 'slip_mm', 'largest_slip_mm', 'peak_n', 'detection_ms', 'refused')
    rows = [(way, *(_text(row.get(name)) for name in names)) for way, row in report.items()]
    title = f'Knocks of {knock:g} mm/s, margin {margin:g}, simulated'
    Console(markup=False).print(make_table(title, ('way', *names), rows))
    settings = {'margin': margin, 'knock_mm_s': knock, 'seed': seed, 'preset': preset}
    write_json(json, {'simulated': True, 'settings': settings, 'ways': report, 'trials': found})


def _text(value: float | None) -> str:
    return '-' if value is None else f'{value:.3g}'


if __name__ == '__main__':
    typer.run(slip)
