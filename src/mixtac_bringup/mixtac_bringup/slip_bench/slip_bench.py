# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The command `mixtac bench slip`."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

import typer

if TYPE_CHECKING:
    from rich.console import Console

    from mixtac_bringup.slip_bench.kept import Kept
    from mixtac_bringup.slip_bench.trial import TrialPlan, TrialResult

OptionalPath = Optional[Path]  # noqa: UP045  (typer evaluates this under Python 3.10)
STIFFNESSES = (10.0, 5.0, 2.0, 1.0)
"""Stiffness of the contact in turns [N/mm]."""


def slip(
    trials: Annotated[int, typer.Option(min=4, help='Trials with the box.')] = 200,
    knock: Annotated[float, typer.Option(help='Speed after the blow (mm/s).')] = 50.0,
    margin: Annotated[float, typer.Option(help='Grasp force over the least that holds.')] = 1.05,
    lag: Annotated[float, typer.Option(help='Time constant of the arm (s).')] = 3.5e-3,
    quiet_minutes: Annotated[float, typer.Option(help='Of each quiet scene (min).')] = 30.0,
    curve_trials: Annotated[int, typer.Option(help='Slips per speed for the curves.')] = 40,
    dds_seconds: Annotated[float, typer.Option(help='Over real DDS (s); 0 for none.')] = 330.0,
    preset: Annotated[str, typer.Option(help='How hard the sensors are.')] = 'paper_like',
    keep: Annotated[
        OptionalPath, typer.Option(help='Keep finished parts in this file and go on from them.')
    ] = None,
    report: Annotated[OptionalPath, typer.Option('--json', help='Write the result.')] = None,
    figure: Annotated[OptionalPath, typer.Option(help='Draw the curves there (PNG).')] = None,
) -> None:
    """Measure slip control: held objects, latency, limits, false alarms. Simulated results."""
    from rich.console import Console

    from mixtac_bringup.slip_bench.closed_loop import ArmSetup
    from mixtac_bringup.slip_bench.kept import Kept
    from mixtac_bringup.slip_bench.trial import TrialPlan, shipped_settings
    from mixtac_sim.arm.tracking import Tracking

    console, kept = Console(), Kept(keep)
    settings = shipped_settings()
    arm = ArmSetup(Tracking(lag))
    plan = TrialPlan(margin=margin, knock_mm_s=knock, preset=preset, arm=arm, settings=settings)
    results = _box_trials(console, plan, trials, kept)
    latency = _over_dds(console, dds_seconds) if dds_seconds > 0.0 else None
    quiet = _quiet(console, quiet_minutes, plan, kept) if quiet_minutes > 0.0 else []
    outcome = _outcome(results, latency, quiet)
    outcome['conditions'] = {
        'margin': margin,
        'knock_mm_s': knock,
        'arm_lag_s': lag,
        'preset': preset,
        'normal': list(plan.arm.normal),
        'transport': asdict(plan.transport),
    }
    if curve_trials > 0:
        from mixtac_bringup.slip_bench.detectors import curves

        outcome['curves'] = curves(curve_trials, settings, preset)
        if figure is not None:
            from mixtac_bringup.slip_bench.figures import draw_curves

            draw_curves(figure, outcome['curves'])
    if report is not None:
        report.write_text(json.dumps(outcome, indent=2) + '\n', encoding='utf-8')
    shown = {k: v for k, v in outcome.items() if k != 'curves'}
    console.print_json(data=shown)


def _box_trials(console: Console, plan: TrialPlan, trials: int, kept: Kept) -> list[TrialResult]:
    """Run the trials with the box, at each stiffness in turn."""
    from dataclasses import replace

    from rich.progress import track

    from mixtac_bringup.slip_bench.kept_trials import kept_trial

    results = []
    for k in track(range(trials), 'box trials', console=console):
        stiffness = STIFFNESSES[k % len(STIFFNESSES)]
        each = replace(plan, seed=70_000 + k, stiffness_n_per_mm=stiffness)
        results.append(kept_trial(each, kept)[0])
    return results


def _over_dds(console: Console, seconds: float) -> Any:  # noqa: ANN401
    from mixtac_bringup.slip_bench.dds_latency import measure

    with console.status('slips over real DDS'):
        return measure(seconds)


def _quiet(console: Console, minutes: float, plan: TrialPlan, kept: Kept) -> list[dict[str, Any]]:
    from rich.progress import track

    from mixtac_bringup.slip_bench.detectors import count_alarms
    from mixtac_bringup.slip_bench.quiet_scene import QUIET

    seconds, names = 60.0 * minutes, track(QUIET, 'quiet scenes', console=console)
    found = [count_alarms(name, seconds, plan.settings, plan.preset, kept) for name in names]
    return [asdict(alarms) for alarms in found]


def _outcome(
    results: list[TrialResult],
    latency: Any,  # noqa: ANN401
    quiet: list[dict[str, Any]],
) -> dict[str, Any]:
    """Return everything but the curves; the latencies are those over DDS where measured."""
    from mixtac_bringup.slip_bench.report import quantiles, summary

    box = summary(results)
    outcome: dict[str, Any] = {
        'simulated': True,
        'detection_ms': box['detection_ms'],
        'publish_ms': box['publish_ms'],
        'latency_from': 'lock-step loop with assumed transport',
        'limit_violations': box['limit_violations'],
        'held_fraction': box['held_fraction'],
        'false_alarms': box['false_alarms'] + sum(each['flow'] for each in quiet),
        'box': box,
        'box_by_stiffness': {
            f'{k:g}': summary([r for r in results if abs(r.stiffness_n_per_mm - k) < 0.02 * k])
            for k in STIFFNESSES
        },
        'quiet': quiet,
    }
    if latency is not None:
        outcome['detection_ms'] = quantiles(latency.detection_ms)
        outcome['publish_ms'] = quantiles(latency.publish_ms)
        outcome['latency_from'] = 'real DDS, measured at a subscriber'
        outcome['dds'] = asdict(latency)
        outcome['false_alarms'] += latency.false_alarms
    return outcome
