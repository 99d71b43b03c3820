# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""False alarms of the shipped detector, and both detectors' curves on the same trials."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import partial
from itertools import starmap
from typing import TYPE_CHECKING, Any

import numpy as np

from mixtac_bringup.slip_bench.kept import Kept, digest
from mixtac_bringup.slip_bench.quiet_scene import QUIET, quiet_blocks, slip_blocks, windows_of
from mixtac_slip_control.detector_curves import detector_curve, score_trial
from mixtac_slip_control.slip_judge import DETECTORS, SlipJudge

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from mixtac_bringup.slip_bench.quiet_scene import QuietName
    from mixtac_slip_control.detector_curves import ScoredTrial
    from mixtac_slip_control.slip_settings import SlipSettings

SPEEDS_MM_S = (10.0, 30.0, 100.0)
LEARN_S = 1.1
SLIP_TRIAL_S = 1.2
QUIET_TRIAL_S = 5.0
PIECE_S = 60.0
"""A long quiet time is made of pieces of so long, each with a sensor and a day of its own [s]."""
QUIET_SEED = 50_000
"""Sensors of the quiet scenes; no threshold was chosen on them."""
SLIP_SEED = 60_000


@dataclass(frozen=True, slots=True)
class Alarms:
    """False alarms on one kind of quiet scene.

    Attributes:
        name: Kind of scene.
        seconds: Simulated time after the background was learned [s].
        flow: Onsets that the flow detector saw.
        count: Onsets that the count law saw.
        mean_count: Mean events per window.
        saturated: Windows in which the sensor was saturated, on which an arm would stop.
    """

    name: str
    seconds: float
    flow: int
    count: int
    mean_count: float
    saturated: int


def count_alarms(
    name: QuietName,
    seconds: float,
    settings: SlipSettings,
    preset_name: str,
    kept: Kept | None = None,
) -> Alarms:
    """Return the false alarms of both detectors with their shipped thresholds.

    Args:
        name: Kind of scene.
        seconds: Simulated time, the learning not counted [s].
        settings: Of the controller.
        preset_name: How hard the sensors are.
        kept: Holds the pieces that were measured before.
    """
    pieces, store = [], kept or Kept()
    watched = digest(settings.window_us, settings.guide, settings.judge, preset_name)
    number = max(round(seconds / PIECE_S), 1)
    for k in range(number):
        length = seconds / number
        key = f'quiet {name} {QUIET_SEED + k} {length:g} s {watched}'
        piece = store.get(key, partial(_quiet_piece, name, k, length, settings, preset_name))
        pieces.append(Alarms(**piece))
    return Alarms(
        name,
        sum(p.seconds for p in pieces),
        sum(p.flow for p in pieces),
        sum(p.count for p in pieces),
        float(np.mean([p.mean_count for p in pieces])),
        sum(p.saturated for p in pieces),
    )


def _quiet_piece(
    name: QuietName, number: int, seconds: float, settings: SlipSettings, preset_name: str
) -> dict[str, Any]:
    """Return the alarms of one sensor on one day, for JSON."""
    judge, was = SlipJudge(settings.judge), dict.fromkeys(DETECTORS, False)
    alarms = dict.fromkeys(DETECTORS, 0)
    counts = windows = saturated = 0
    blocks = quiet_blocks(name, LEARN_S + seconds, QUIET_SEED + number, preset_name)
    for window in windows_of(blocks, settings):
        judge.update(window, 0.0)
        says = {'flow': judge.flow.slipping, 'count': judge.count.slipping}
        if window.end_us > 1e6 * LEARN_S:
            for each in DETECTORS:
                alarms[each] += says[each] and not was[each]
            counts, windows = counts + window.count, windows + 1
            saturated += window.count >= settings.safety.saturation_count
        was = says
    mean = counts / max(windows, 1)
    return asdict(Alarms(name, seconds, alarms['flow'], alarms['count'], mean, saturated))


def curves(
    trials: int,
    settings: SlipSettings,
    preset_name: str,
    progress: Callable[[Sequence[int]], Sequence[int]] = lambda numbers: numbers,
) -> dict[str, Any]:
    """Return latency against false alarms of both detectors, by speed, for JSON.

    Args:
        trials: Slips per speed.
        settings: Of the controller.
        preset_name: How hard the sensors are.
        progress: Wraps the numbers of the trials.
    """
    quiet = list(
        starmap(
            lambda k, name: _scored_quiet(name, k, settings, preset_name),
            [(k, name) for k in range(max(trials // 5, 1)) for name in QUIET],
        )
    )
    result: dict[str, Any] = {}
    for speed in SPEEDS_MM_S:
        slips = []
        for k in progress(range(trials)):
            # Windows lie on whole milliseconds; onsets lie anywhere between them.
            onset_s = LEARN_S + 1e-3 * (20.0 + k / trials)
            blocks = slip_blocks(speed, onset_s, SLIP_TRIAL_S, SLIP_SEED + k, preset_name)
            scored = _scored(list(windows_of(blocks, settings)), settings)
            slips.append((scored, round(1e6 * onset_s)))
        result[f'{speed:g}_mm_s'] = {each: _curve(each, slips, quiet) for each in DETECTORS}
    return result


def _scored_quiet(
    name: QuietName, number: int, settings: SlipSettings, preset_name: str
) -> ScoredTrial:
    blocks = quiet_blocks(name, LEARN_S + QUIET_TRIAL_S, QUIET_SEED + 100 + number, preset_name)
    return _scored(list(windows_of(blocks, settings)), settings)


def _scored(windows: list[Any], settings: SlipSettings) -> ScoredTrial:
    learning = round(1e6 * LEARN_S / settings.window_us)
    return score_trial(windows, learning, settings.judge.count, settings.judge.flow)


def _curve(
    detector: str, slips: list[tuple[ScoredTrial, int]], quiet: list[ScoredTrial]
) -> dict[str, Any]:
    curve = detector_curve(detector, slips, quiet)
    shipped = int(np.argmin(np.abs(np.log(curve.scale))))
    return {
        'auc': round(curve.auc, 4),
        'shipped': {
            'latency_p50_ms': _number(curve.latency_ms[shipped]),
            'latency_p99_ms': _number(curve.latency_p99_ms[shipped]),
            'false_alarms_per_min': round(float(curve.false_alarms_per_min[shipped]), 3),
            'missed': round(float(curve.missed[shipped]), 4),
        },
        'scale': [round(float(v), 4) for v in curve.scale],
        'false_alarms_per_min': [round(float(v), 3) for v in curve.false_alarms_per_min],
        'latency_ms': [_number(v) for v in curve.latency_ms],
        'missed': [round(float(v), 4) for v in curve.missed],
    }


def _number(value: float) -> float | None:
    """Return a latency for JSON, None for never."""
    return round(float(value), 3) if np.isfinite(value) else None
