# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Whether the force returns to zero: after presses, slides and turns on unseen simulated sensors.

A repetition counts by the mean of the estimate from 1 to 1.5 s after the release, less its mean
over the half second before the contact, both times the gain of one press beside a reference
sensor. When contact begins and ends, the true force says.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Annotated, Any

import numpy as np
import torch
import typer
from numpy.typing import NDArray
from rich.console import Console

from mixtac_cli.figures import make_table, progress_bar
from mixtac_cli.options import JsonFile, ModelName
from mixtac_fger.weights import DEFAULT_MODEL, Model, find_model, read_model
from mixtac_lab.experiments.sizes import PRESET
from mixtac_learning.judge.estimators import TrialEstimate, sensor_scales, trial_estimator
from mixtac_learning.trials.simulated import SimulatedSource
from mixtac_node.files import write_json
from mixtac_sim.world.training_trials import TrialSpec

GESTURES = {'press': 'touch', 'slide': 'slide', 'torsion': 'torsion'}
"""Profile of each gesture."""
FIRST_DEVICE = 890_000
"""First seed of sensors and trials: beyond those of training and of the other studies."""
WITHIN_N = 0.02
"""Largest change of the zero that passes [N]."""
TOUCHED_N = 0.002
"""True force from which on there is contact [N]."""
SHORTEST_US = 200_000
"""Contacts that are shorter are synchronising impulses [us]."""
BEFORE_US, AFTER_US = (-500_000, -20_000), (1_000_000, 1_500_000)
"""Spans of the zero: to the begin of the contact, and from its end on [us]."""
REPETITION_S, AROUND_S = 3.4, 2.5
"""Longest repetition of a gesture, and what comes before the first and after the last [s]."""


def zeros(estimate: TrialEstimate) -> NDArray[np.float64]:
    """Return the estimate before each contact of a trial and after it [n, 2] [N]."""
    touched = np.concatenate([[False], estimate.known > TOUCHED_N, [False]])
    edges = np.flatnonzero(np.diff(touched.astype(np.int8))).reshape(-1, 2)
    t_us, found = estimate.t_us, []
    for begin, end in edges.tolist():
        start_us, stop_us = int(t_us[begin]), int(t_us[end - 1])
        spans = [start_us + each for each in BEFORE_US], [stop_us + each for each in AFTER_US]
        if stop_us - start_us > SHORTEST_US and spans[1][1] <= t_us[-1]:
            means = [estimate.force[(t_us >= a) & (t_us < b)].mean() for a, b in spans]
            found.append(means)
    return np.array(found, np.float64).reshape(-1, 2)


def summarise(gesture: str, zeros_n: NDArray[np.float64]) -> dict[str, Any]:
    """Return a row of the table.

    Args:
        gesture: Name of the gesture.
        zeros_n: Estimates before and after each contact [n, 2] [N].

    Returns:
        `repetitions`; `within`, how many changes of the zero are at most `WITHIN_N`; `worst_n`,
        `median_n` and `mean_n` (signed) of these changes; `worst_zero_n`, the largest estimate
        after a contact itself [N].
    """
    change = zeros_n[:, 1] - zeros_n[:, 0]
    return {
        'gesture': gesture,
        'repetitions': len(change),
        'within': int(np.sum(np.abs(change) <= WITHIN_N)),
        'worst_n': round(float(np.abs(change).max()), 4),
        'median_n': round(float(np.median(np.abs(change))), 4),
        'mean_n': round(float(change.mean()), 4),
        'worst_zero_n': round(float(np.abs(zeros_n[:, 1]).max()), 4),
    }


def zero_study(
    model: Model, sensors: int, repetitions: int, advance: Callable[[], None]
) -> list[dict[str, Any]]:
    """Return a row per gesture.

    Args:
        model: Content of a weight file.
        sensors: Number of unseen sensors.
        repetitions: Of each gesture on each sensor.
        advance: Called after each trial.
    """
    estimator = trial_estimator(model)
    seconds = REPETITION_S * repetitions + AROUND_S
    found: dict[str, list[NDArray[np.float64]]] = {gesture: [] for gesture in GESTURES}
    for device in range(FIRST_DEVICE, FIRST_DEVICE + sensors):
        press = TrialSpec(device, device + 10_000, 'press', 8.0, PRESET)
        (scale,) = sensor_scales(estimator, [SimulatedSource(press)], fallback=1.0).values()
        advance()
        for number, (gesture, profile) in enumerate(GESTURES.items()):
            spec = replace(
                press, trial_seed=device + 20_000 + 1000 * number, profile=profile, seconds=seconds
            )
            estimate = estimator(SimulatedSource(spec).load()).scaled(scale)
            found[gesture].append(zeros(estimate)[:repetitions])
            advance()
    return [summarise(gesture, np.concatenate(each)) for gesture, each in found.items()]


def zero(
    model: ModelName = DEFAULT_MODEL,
    quick: Annotated[
        bool, typer.Option('--quick', help='Two sensors with three repetitions each.')
    ] = False,
    json: JsonFile = None,
) -> None:
    """Show how far the force returns to zero after presses, slides and turns."""
    torch.set_num_threads(1)
    sensors, repetitions = (2, 3) if quick else (10, 10)
    with progress_bar('testing', sensors * (1 + len(GESTURES))) as advance:
        rows = zero_study(read_model(find_model(model)), sensors, repetitions, advance)
    shown = [
        (
            row['gesture'],
            f'{row["within"]} of {row["repetitions"]}',
            *(f'{row[name]:.4f}' for name in ('median_n', 'worst_n', 'mean_n', 'worst_zero_n')),
        )
        for row in rows
    ]
    headings = (
        'after',
        f'within {WITHIN_N} N',
        'median change [N]',
        'largest [N]',
        'mean [N]',
        'largest zero [N]',
    )
    Console(markup=False).print(
        make_table(f'zero after a contact, {PRESET}, simulated', headings, shown)
    )
    result = {'model': str(find_model(model)), 'quick': quick, 'simulated': True}
    write_json(json, {**result, 'sensors': sensors, 'within_n': WITHIN_N, 'rows': rows})
