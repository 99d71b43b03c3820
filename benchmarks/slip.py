# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What holds a knocked object: trials of slip control in closed loop, simulated, in lock-step.

Each trial is run without control, with the press alone, with the answer to slip alone, with both,
and by the law of the paper. All runs of a trial continue from the same instant of enabling. A
margin is the grasp force relative to the smallest force that holds.
"""

from __future__ import annotations

import multiprocessing
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
from joblib import Parallel, delayed
from rich.console import Console
from rich.progress import track

from mixtac.figures import make_table
from mixtac.options import JsonFile
from mixtac_core.node.files import write_json
from mixtac_learning.experiments.slip import ENABLE_S, TrialPlan, finish_trial, start_trial
from mixtac_slip_control.errors import SlipControlError

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

    from mixtac_learning.experiments.slip import ClosedLoop

OBJECTS = ('box', 'cup', 'ball')
WAYS: dict[str, dict[str, Any]] = {
    'margin': {'min_flow': 100.0},
    'answer': {'grip_margin': 1.0},
    'both': {},
    'paper': {'law': 'paper'},
}
"""Parameters of slip control that differ from the defaults, by the name of the way."""
COLUMNS = {
    'trials': 'trials',
    'held': 'held',
    'mm': 'median_mm',
    'most mm': 'largest_slip_mm',
    'missed': 'undetected',
    'peak N': 'peak_n',
}
"""Names in JSON of the printed columns."""
FORK = multiprocessing.get_context('fork')
"""A child continues with the state of its parent."""


def run(plans: list[TrialPlan], ways: list[str]) -> list[dict[str, dict[str, Any]]]:
    """Return the results of ways for plans of one seed, whose gain is measured once."""
    return [run_ways(plan, ways) for plan in plans]


def run_ways(plan: TrialPlan, ways: list[str]) -> dict[str, dict[str, Any]]:
    """Return the result of each way of a trial; `refused` says why it could not be enabled."""
    loop = start_trial(plan)
    found: dict[str, dict[str, Any]] = {}
    for way in ways:
        here, there = FORK.Pipe(duplex=False)
        way_plan = replace(plan, settings=replace(plan.settings, **WAYS[way]))
        child = FORK.Process(target=finish, args=(way_plan, loop, there))
        child.start()
        there.close()
        found[way] = here.recv()
        child.join()
    free = plan.uncontrolled()
    return {'none': {name: free[name] for name in ('held', 'slip_mm')}} | found


def finish(plan: TrialPlan, loop: ClosedLoop, answer: Connection) -> None:
    """Send the result of a trial from its enabling on."""
    try:
        answer.send(finish_trial(plan, loop))
    except SlipControlError as error:
        answer.send({'name': plan.name, 'seed': plan.seed, 'refused': str(error)})


def summary(results: list[dict[str, Any]]) -> dict[str, Any]:
    """Return counts and medians of trials; those that were refused count apart."""
    ran = [each for each in results if 'refused' not in each]
    found = {'trials': len(ran), 'refused': len(results) - len(ran)}
    if not ran:
        return found
    slips = [each['slip_mm'] for each in ran]
    found |= {
        'held': sum(each['held'] for each in ran),
        'median_mm': float(np.median(slips)),
        'largest_slip_mm': max(slips),
    }
    if 'detection_ms' not in ran[0]:
        return found
    times = [each['detection_ms'] for each in ran if each['detection_ms'] is not None]
    return found | {
        'undetected': len(ran) - len(times),
        'detection_ms': float(np.median(times)) if times else None,
        'peak_n': max(each['peak_n'] for each in ran),
        'false_alarms': sum(each['false_alarms'] for each in ran),
        'limit_violations': sum(each['limit_violations'] for each in ran),
        'stops': sum(bool(each['stopped']) for each in ran),
    }


def slip(
    trials: Annotated[int, typer.Option(min=1, help='Trials per margin.')] = 6,
    margin: Annotated[
        list[float] | None, typer.Option(min=1.0, max=5.0, help='Margin; repeat for several.')
    ] = None,
    knock: Annotated[float, typer.Option(min=0.0, max=500.0, help='Knock (mm/s).')] = 50.0,
    after: Annotated[
        float, typer.Option(min=0.01, max=600.0, help='Time from enabling to the knock (s).')
    ] = 0.35,
    pull: Annotated[
        float | None,
        typer.Option(
            min=0.001, max=0.3, help='Let the momentum of the knock act slowly, over this time (s).'
        ),
    ] = None,
    way: Annotated[
        list[str] | None,
        typer.Option(help='margin, answer, both or paper; repeat for several, omit for all.'),
    ] = None,
    grasp_force: Annotated[
        tuple[float, float] | None,
        typer.Option(help='Least and largest grasp force (N): objects are weighed for them.'),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help='Seed of the first trial.')] = 900,
    preset: Annotated[str, typer.Option(help='Difficulty of the sensor.')] = 'paper_like',
    jobs: Annotated[int, typer.Option(min=1, help='Trials at once.')] = 1,
    json: JsonFile = None,
) -> None:
    """Knock objects in a simulated grasp: no control, press, answer, both, the paper's law."""
    if unknown := set(way or ()) - WAYS.keys():
        raise typer.BadParameter(f'{", ".join(unknown)}: choose among {", ".join(WAYS)}')
    margins = margin or [1.05]
    forces = [None] * trials if grasp_force is None else np.linspace(*grasp_force, trials).tolist()
    plans = [
        [
            TrialPlan(
                OBJECTS[number % len(OBJECTS)],
                seed + number,
                each,
                knock,
                preset=preset,
                knock_s=round(ENABLE_S + after, 6),
                grasp_n=force,
                pulse_s=pull,
            )
            for each in margins
        ]
        for number, force in enumerate(forces)
    ]
    work = Parallel(n_jobs=jobs, return_as='generator')(
        delayed(run)(each, list(way or WAYS)) for each in plans
    )
    settings = {'knock_mm_s': knock, 'after_s': after, 'pull_s': pull, 'seed': seed}
    settings |= {'preset': preset, 'grasp_force_n': grasp_force}
    results: list[list[dict[str, dict[str, Any]]]] = []
    for result in track(work, 'Trials', total=trials):
        results.append(result)
        found = {
            f'{each:g}': {name: [all_[k][name] for all_ in results] for name in result[k]}
            for k, each in enumerate(margins)
        }
        report = {
            each: {name: summary(all_) for name, all_ in ways.items()}
            for each, ways in found.items()
        }
        # A run that is interrupted keeps what it has found.
        write_json(
            json, {'simulated': True, 'settings': settings, 'margins': report, 'trials': found}
        )
    rows = [
        (each, way, *(_text(row.get(name)) for name in COLUMNS.values()))
        for each, ways in report.items()
        for way, row in ways.items()
    ]
    title = f'Knocks of {knock:g} mm/s, simulated'
    Console(markup=False).print(make_table(title, ('margin', 'way', *COLUMNS), rows))


def _text(value: float | None) -> str:
    return '-' if value is None else f'{value:.3g}'


if __name__ == '__main__':
    typer.run(slip)
