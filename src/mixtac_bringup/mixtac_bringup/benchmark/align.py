# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The command `mixtac bench align`: errors of the clock maps against known truth."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Optional

import numpy as np
import typer

from mixtac_events.errors import MixtacError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_alignment.clock_fit import ClockFit
    from mixtac_alignment.refinement import Refinement
    from mixtac_alignment.sensor_pool import SensorTiming
    from mixtac_bringup.benchmark.align_trials import TrialRecording

OptionalPath = Optional[Path]  # noqa: UP045  (typer evaluates this under Python 3.10)
POINTS: Final = 41
"""Times over a trial at which the error is taken."""
WRONG_S: Final = 2e-3
"""A map with a larger error is wrong."""
METHODS: Final = ('paper', 'two_impulse', 'refined', 'two_impulse_pooled', 'refined_pooled')
"""Pooled: with gel and latency of the sensor from all its trials, as `mixtac align` on a folder."""


@dataclass(slots=True)
class Scores:
    """Errors of one method.

    Attributes:
        errors_s: Per trial, time error over the trial [s].
        inside: Per trial, share of these within the stated 95 % interval.
        refused: Trials without a map.
    """

    errors_s: list[NDArray[np.float64]] = field(default_factory=list)
    inside: list[float] = field(default_factory=list)
    refused: int = 0

    def add(self, fit: ClockFit, recording: TrialRecording) -> None:
        """Add the map of a recording."""
        times = _times(recording)
        error = fit.to_reference(times) - recording.true_s(times)
        self.errors_s.append(np.abs(error))
        self.inside.append(float(np.mean(np.abs(error) <= 1.96 * fit.std_at(times))))

    def summary(self) -> dict[str, float]:
        """Return quantiles [ms], coverage and numbers."""
        if not self.errors_s:
            return {'trials': 0, 'refused': self.refused}
        p50, p95 = 1e3 * np.percentile(np.concatenate(self.errors_s), [50, 95])
        return {
            'p50': round(float(p50), 3),
            'p95': round(float(p95), 3),
            'coverage_95': round(float(np.mean(self.inside)), 3),
            'trials': len(self.errors_s),
            'refused': self.refused,
        }


def align(
    trials: Annotated[int, typer.Option(min=1, help='Simulated trials.')] = 200,
    damaged: Annotated[int, typer.Option(min=0, help='Damaged trials.')] = 100,
    seconds: Annotated[float, typer.Option(min=8.0, help='Length of a trial.')] = 25.0,
    cache: Annotated[OptionalPath, typer.Option(help='Folder that keeps the recordings.')] = None,
    report: Annotated[OptionalPath, typer.Option('--json', help='Write the result.')] = None,
) -> None:
    """Measure the error of the clock alignment on simulated trials with known clocks."""
    from rich.console import Console
    from rich.progress import track

    from mixtac_bringup.benchmark.align_trials import simulate_recording

    console = Console()
    scores = {name: Scores() for name in METHODS}
    groups: dict[str, Scores] = {}
    faults = DamageScores()
    sensor: list[TrialRecording] = []
    for number in track(range(trials), 'aligning', console=console):
        recording = simulate_recording(number, seconds, cache)
        if sensor and sensor[0].sensor != recording.sensor:
            score_sensor(sensor, scores, groups)
            sensor = []
        sensor.append(recording)
        if number < damaged:
            faults.add(recording, number)
    score_sensor(sensor, scores, groups)
    result = {'seconds': seconds} | summarise(scores, groups, faults)
    console.print_json(data=result)
    if report is not None:
        report.write_text(json.dumps(result, indent=2) + '\n', encoding='utf-8')


def score_sensor(
    recordings: list[TrialRecording], scores: dict[str, Scores], groups: dict[str, Scores]
) -> None:
    """Fit the recordings of a sensor, each alone and with what all of them say of the sensor."""
    from mixtac_alignment.refinement import refine
    from mixtac_alignment.sensor_pool import pool_sensor
    from mixtac_alignment.tap_anchors import fit_taps

    def fit(each: TrialRecording, suffix: str, known: SensorTiming | None) -> Refinement | None:
        lag, settings = (None, None) if known is None else (known.lag, known.settings)
        data = (each.frames, each.force_t_s, each.force)
        try:
            first = fit_taps(each.counts, each.events, *data, settings, lag)
        except MixtacError:
            scores[f'two_impulse{suffix}'].refused += 1
            scores[f'refined{suffix}'].refused += 1
            return None
        scores[f'two_impulse{suffix}'].add(first, each)
        try:
            refined = refine(first, *data, lag)
        except MixtacError:
            scores[f'refined{suffix}'].refused += 1
            return None
        scores[f'refined{suffix}'].add(refined.fit, each)
        groups.setdefault(f'refined{suffix} {each.preset}', Scores()).add(refined.fit, each)
        return refined

    found = [fit(each, '', None) for each in recordings]
    known = pool_sensor([refined for refined in found if refined is not None])
    for each in recordings:
        fit(each, '_pooled', known)
        _score_paper(each, scores['paper'])


def _score_paper(recording: TrialRecording, scores: Scores) -> None:
    from mixtac_alignment.two_impulse import fit_counts

    try:
        scores.add(fit_counts(recording.counts, recording.force_t_s, recording.force), recording)
    except MixtacError:
        scores.refused += 1


@dataclass(slots=True)
class DamageScores:
    """What became of damaged recordings, by kind.

    Attributes:
        refused: Refused with a reason.
        right: Solved, within 2 ms over the whole trial.
        wrong: Solved, but not right.
        worst_ms: Largest error of a solved one [ms].
    """

    refused: dict[str, int] = field(default_factory=dict)
    right: dict[str, int] = field(default_factory=dict)
    wrong: dict[str, int] = field(default_factory=dict)
    worst_ms: float = 0.0

    def add(self, recording: TrialRecording, number: int) -> None:
        """Damage a recording in the way whose turn it is, and align it."""
        from mixtac_alignment.align import align as align_recording
        from mixtac_bringup.benchmark.align_trials import DAMAGES, damage

        kind = DAMAGES[number % len(DAMAGES)]
        try:
            broken = damage(recording, kind, np.random.default_rng(number))
            fit, _ = align_recording(
                broken.counts,
                broken.force_t_s,
                broken.force,
                broken.frames,
                events=broken.events,
            )
        except MixtacError:
            self.refused[kind] = self.refused.get(kind, 0) + 1
            return
        times = _times(recording)
        worst = float(np.abs(fit.to_reference(times) - recording.true_s(times)).max())
        self.worst_ms = max(self.worst_ms, 1e3 * worst)
        tally = self.right if worst <= WRONG_S else self.wrong
        tally[kind] = tally.get(kind, 0) + 1


def summarise(
    scores: dict[str, Scores], groups: dict[str, Scores], faults: DamageScores
) -> dict[str, Any]:
    """Return the result of the benchmark."""
    result: dict[str, Any] = {f'{name}_ms': each.summary() for name, each in scores.items()}
    result['coverage_95'] = result['refined_ms'].get('coverage_95')
    result['by_preset_ms'] = {name: each.summary() for name, each in groups.items()}
    result['silently_wrong'] = sum(faults.wrong.values())
    result['damaged'] = {
        'refused': faults.refused,
        'right': faults.right,
        'wrong': faults.wrong,
        'worst_ms': round(faults.worst_ms, 3),
    }
    return result


def _times(recording: TrialRecording) -> NDArray[np.int64]:
    return np.linspace(recording.events.t_us[0], recording.events.t_us[-1], POINTS).astype(np.int64)
