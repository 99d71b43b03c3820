# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Sideways force and torsion on unseen simulated sensors, by what the contact does.

Each sensor is calibrated by a press of known force and by a mass on a thread, as
`calibrate-force --sideways-loads` does (another day, another place), then handled, rolled and
turned. A window of a contact sticks, slips at its rim or slides by
the share of the friction that it uses, which the simulator knows.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

import numpy as np
import torch
import typer
from numpy.typing import NDArray
from rich.console import Console

from mixtac_cli.figures import make_table, progress_bar
from mixtac_cli.options import JsonFile, ModelName
from mixtac_fger.force_calibration import ForceCalibrationError
from mixtac_fger.weights import DEFAULT_MODEL, Model, find_model, read_model
from mixtac_lab.experiments.sizes import PRESET
from mixtac_lab.slip.sensing import PULLS_S, pulled_gain
from mixtac_learning.judge.estimators import TrialEstimate, sensor_scales, trial_estimator
from mixtac_learning.trials.simulated import SimulatedSource
from mixtac_node.files import write_json
from mixtac_sim.mechanics.elastomer import Shear
from mixtac_sim.world.device import draw_conditions, draw_device
from mixtac_sim.world.effects import preset
from mixtac_sim.world.training_trials import TrialSpec

FIRST_DEVICE = 920_000
"""First seed of sensors and trials: beyond those of training and of the other studies."""
SECONDS = {'handling': 10.0, 'torsion': 6.0, 'roll': 6.0}
"""Length of each trial by profile, without those for calibration [s]."""
NEAR_MM = 3.0
"""Farthest first touch from the optical axis [mm]."""
TOUCHED_N = 0.03
"""True normal force from which on a window counts [N]."""
STICKS, SLIDES = 0.3, 0.95
"""Shares of the friction below which a contact counts as stuck, and above which it slides."""
GAINS = ('mae_uncalibrated', 'mae', 'mae_normal_gain', 'mae_pulled_gain')
"""Errors with no gain; with the gain that pulls let expect elsewhere, and that of the normal force;
with the latter alone; with the gain that the pulls had themselves."""
TARGETS = {'sideways force [N]': 0.05, 'torsion [N mm]': 0.5}
ANCHORS = {
    'source': 'arXiv 2606.09451: events, measured, 100 Hz',
    'mae_n': [0.14, 0.10, 0.93],
    'range_n': [4.0, 4.0, 20.0],
}
"""Errors of force x, y, z beside which these figures stand, and over which ranges."""


def near_seed(first: int) -> int:
    """Return the first trial seed from `first` on whose contact is at most `NEAR_MM` off-axis."""
    level, seed = preset(PRESET), first
    while np.hypot(*draw_conditions(seed, level).contact_mm) > NEAR_MM:
        seed += 1
    return seed


def friction_share(estimate: TrialEstimate, spec: TrialSpec) -> NDArray[np.float64]:
    """Return the pull of each window over the largest that friction bears, [T]."""
    level = preset(PRESET)
    device, day = draw_device(spec.device_seed, level), draw_conditions(spec.trial_seed, level)
    friction = device.friction * day.friction
    shear = Shear(device.layer, friction, (0.0, 0.0), level.contact.friction_load)
    pull = np.hypot(*_known(estimate)[:, :2].T)
    return np.asarray(pull / np.maximum(shear.limit(estimate.known), 1e-9))


def _known(estimate: TrialEstimate) -> NDArray[np.float64]:
    if estimate.known_across is None or estimate.across is None:
        raise ValueError(f'{estimate.name} has no sideways force')
    return estimate.known_across


def case_masks(
    profile: str, estimate: TrialEstimate, share: NDArray[np.float64]
) -> dict[str, NDArray[np.bool_]]:
    """Return which windows of a trial belong to which case."""
    touched = estimate.known > TOUCHED_N
    if profile != 'handling':
        return {profile: touched}
    return {
        'stick': touched & (share < STICKS),
        'partial slip': touched & (share >= STICKS) & (share < SLIDES),
        'slide': touched & (share >= SLIDES),
    }


def sensor_rows(model: Model, device: int, advance: Callable[[], None]) -> dict[str, Any]:
    """Return errors of one sensor by case: columns of true values and estimates.

    Args:
        model: Content of a weight file.
        device: Seed of the sensor.
        advance: Called after each trial.

    Returns:
        By case, [T, 3 + 3 `GAINS`]: true x, y [N], torque [N mm]; the same by each way of `GAINS`.
    """
    estimator = trial_estimator(model)

    def judged(profile: str, seconds: float, number: int) -> tuple[TrialEstimate, TrialSpec]:
        seed = near_seed(device + 10_000 * (1 + number))
        spec = TrialSpec(device, seed, profile, seconds, PRESET)
        found = estimator(SimulatedSource(spec).load())
        advance()
        return found, spec

    press = TrialSpec(device, near_seed(device + 10_000), 'press', 6.0, PRESET)
    (normal,) = sensor_scales(estimator, [SimulatedSource(press)], fallback=1.0).values()
    advance()
    pulled, pulled_sd, sideways, sideways_sd, refused = normal, 0.0, normal, 0.0, ''
    try:
        pulls, _ = judged('pulls', PULLS_S, 1)
        t_s = 1e-6 * (pulls.t_us - pulls.t_us[0])
        fit = pulled_gain(t_s, pulls.force, np.asarray(pulls.across)[:, :2])
        pulled, pulled_sd = fit.gain, fit.gain_sd
        sideways, sideways_sd = fit.elsewhere(normal)
    except ForceCalibrationError as error:
        refused = error.reason
    found: dict[str, Any] = {
        'normal_gain': normal,
        'pulled_gain': pulled,
        'pulled_gain_sd': pulled_sd,
        'sideways_gain': sideways,
        'sideways_gain_sd': sideways_sd,
        'refused': refused,
        'cases': {},
    }
    for number, (profile, seconds) in enumerate(SECONDS.items()):
        estimate, spec = judged(profile, seconds, 2 + number)
        units = np.array([1.0, 1.0, 1e3])
        known = _known(estimate) * units
        raw = np.asarray(estimate.across)[:, :3] * units
        ways = (raw * gain for gain in (sideways, normal, pulled))
        columns = np.concatenate([known, raw, *ways], axis=1)
        share = friction_share(estimate, spec)
        for case, mask in case_masks(profile, estimate, share).items():
            found['cases'][case] = columns[mask & np.isfinite(raw).all(axis=1)]
    return found


def summarise(sensors: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return a row per quantity and case, of all windows of all sensors."""
    rows = []
    cases = list(dict.fromkeys(case for each in sensors for case in each['cases']))
    for quantity, axes in (('sideways force [N]', [0, 1]), ('torsion [N mm]', [2])):
        for case in (*cases, 'all'):
            chosen = cases if case == 'all' else [case]
            parts = [s['cases'][name] for s in sensors for name in chosen if name in s['cases']]
            table = np.concatenate(parts)
            known = table[:, axes]
            errors = {
                name: round(float(np.abs(table[:, [3 * k + i for i in axes]] - known).mean()), 4)
                for k, name in enumerate(GAINS, 1)
            }
            calibrated = [3 * (1 + GAINS.index('mae')) + i for i in axes]
            by_sensor = [
                float(np.abs(p[:, calibrated] - p[:, axes]).mean()) for p in parts if len(p)
            ]
            rows.append(
                {
                    'quantity': quantity,
                    'case': case,
                    'windows': len(table),
                    **errors,
                    'worst_sensor_mae': round(max(by_sensor, default=0.0), 4),
                    'mean_size': round(float(np.abs(known).mean()), 4),
                    'largest': round(float(np.abs(known).max(initial=0.0)), 4),
                    'target': TARGETS[quantity],
                }
            )
    return rows


def contact(
    model: ModelName = DEFAULT_MODEL,
    quick: Annotated[bool, typer.Option('--quick', help='Three sensors of 12.')] = False,
    json: JsonFile = None,
) -> None:
    """Show the errors of sideways force and torsion on unseen sensors, by what the contact does."""
    torch.set_num_threads(1)
    count = 3 if quick else 12
    loaded = read_model(find_model(model))
    with progress_bar('testing', count * (2 + len(SECONDS))) as advance:
        sensors = [sensor_rows(loaded, FIRST_DEVICE + index, advance) for index in range(count)]
    rows = summarise(sensors)
    names = ('windows', *GAINS, 'worst_sensor_mae', 'mean_size', 'largest')
    shown = [
        (row['quantity'], row['case'], *(f'{row[name]:g}' for name in (*names, 'target')))
        for row in rows
    ]
    headings = ('error of', 'contact', *(name.replace('_', ' ') for name in names), 'target')
    Console(markup=False).print(
        make_table(f'contact, {count} unseen sensors, simulated', headings, shown)
    )
    gains = [{name: each[name] for name in each if name != 'cases'} for each in sensors]
    result = {'model': str(find_model(model)), 'quick': quick, 'simulated': True}
    write_json(json, {**result, 'gains': gains, 'anchors': ANCHORS, 'rows': rows})
