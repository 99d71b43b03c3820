# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What known weights, one press and adaptation gain on simulated sensors that no training has used.

The weights are also put on wrongly, to see which calibrations are refused.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
import typer
from rich.console import Console

from mixtac_cli.options import JsonFile, ModelName
from mixtac_fger.force_calibration import (
    ForceCalibration,
    ForceCalibrationError,
    find_plateaus,
    fit_gain,
    load_of,
)
from mixtac_fger.weights import DEFAULT_MODEL, Model, find_model, read_model
from mixtac_lab.experiments.sizes import TABLE_FULL
from mixtac_lab.experiments.studies.models import unseen_specs
from mixtac_learning.adapt.adaptation import adapt
from mixtac_learning.adapt.presses import gather_presses
from mixtac_learning.judge.estimators import (
    TrialEstimate,
    judge_sources,
    sensor_scales,
    trial_estimator,
)
from mixtac_learning.judge.metrics import CalibrationError
from mixtac_learning.judge.report import show_figures, summarise
from mixtac_learning.network import model_of, network_of
from mixtac_learning.trials.simulated import SimulatedSource
from mixtac_learning.trials.store import CachedSource
from mixtac_learning.trials.trial import TrialSource
from mixtac_node.files import write_json
from mixtac_sim.world.gestures import WEIGHTS_G
from mixtac_sim.world.training_trials import TrialSpec

BEFORE, WEIGHTS, ONE_GAIN, ADAPTED = 'before', 'known_weights', 'one_gain', 'adapted'
WEIGHTS_S = 18.0
"""Length of the recording in which the known weights are put on [s]."""
WEIGHT_ERROR_G = 1.0
"""Each weight is wrong by up to this much [g]."""
PRESSES = 3
"""Recordings of 8 s for the adaptation: the press that gives the one gain, and others."""


def adaptation_study(
    model: Model, sensors: int, cache: Path, log: Callable[[str], None]
) -> dict[str, Any]:
    """Test a model on sensors that no training used, in three states.

    Args:
        model: Content of a weight file of FGER-Net.
        sensors: Number of sensors.
        cache: Folder for stored trials.
        log: Called with each step.

    Returns:
        `before`, `known_weights` (one gain of three weights whose times nobody notes), `one_gain`
        (from one press of 8 s beside a reference sensor) and `adapted` (by `PRESSES` recordings),
        each with the figures of `summarise` and `sensor_mae`, one value per sensor; `ways`: the
        kinds of adaptation chosen; `refused`: sensors whose weights were refused; `spoiled`: what
        became of calibrations that were spoiled, of `spoiled_weights`, by kind.
    """

    def cached(spec: TrialSpec) -> TrialSource:
        return CachedSource(SimulatedSource(spec), cache)

    chosen = replace(TABLE_FULL, unseen=sensors)
    found: dict[str, list[Any]] = {name: [] for name in (BEFORE, WEIGHTS, ONE_GAIN, ADAPTED)}
    ways: list[str] = []
    refused = 0
    spoiled = {kind: dict.fromkeys(('refused', 'flagged', 'accepted'), 0) for kind in SPOILED}
    for test, press in zip(*unseen_specs(chosen), strict=True):
        log(f'sensor {test.device_seed}')
        seeds = [press.trial_seed + 10_000 * number for number in range(PRESSES)]
        presses = [cached(replace(press, trial_seed=seed)) for seed in seeds]
        estimator = trial_estimator(model)
        raw = judge_sources(estimator, [cached(test)]).estimates
        scales = sensor_scales(estimator, presses[:1], fallback=1.0)
        network, way = _adapted(model, presses)
        ways.append(way)
        found[BEFORE] += raw
        put_on = replace(
            press, trial_seed=press.trial_seed + 100_000, profile='weights', seconds=WEIGHTS_S
        )
        by_weights = estimator(cached(put_on).load())
        try:
            gain = calibrate_by_weights(by_weights, test.device_seed).gain
            for kind, outcome in spoiled_weights(by_weights, test.device_seed).items():
                spoiled[kind][outcome] += 1
        except ForceCalibrationError as error:
            log(f'sensor {test.device_seed}: {error}')
            gain, refused = 1.0, refused + 1
        found[WEIGHTS] += [each.scaled(gain) for each in raw]
        found[ONE_GAIN] += [each.scaled(scales[each.device]) for each in raw]
        after = trial_estimator(model_of(network, model.card))
        found[ADAPTED] += judge_sources(after, [cached(test)]).estimates
    rows: dict[str, Any] = {}
    for name, estimates in found.items():
        each = [round(float(np.mean(np.abs(e.force - e.known))), 4) for e in estimates]
        rows[name] = summarise(estimates) | {'sensor_mae': each}
    return rows | {'ways': ways, 'refused': refused, 'spoiled': spoiled}


def calibrate_by_weights(
    estimate: TrialEstimate, seed: int, named_g: Sequence[float] = WEIGHTS_G
) -> ForceCalibration:
    """Return the calibration by the weights of the profile `weights`, each named wrong.

    Args:
        estimate: Estimate of the trial.
        seed: Fixes the errors of the weights.
        named_g: What they are said to weigh, but for these errors [g].

    Raises:
        ForceCalibrationError: They are refused.
    """
    errors = np.random.default_rng(seed).uniform(-WEIGHT_ERROR_G, WEIGHT_ERROR_G, len(WEIGHTS_G))
    loads = [
        load_of(grams + error, WEIGHT_ERROR_G)
        for grams, error in zip(named_g, errors.tolist(), strict=True)
    ]
    t_s = np.asarray(1e-6 * estimate.t_us, np.float64)
    return fit_gain(loads, find_plateaus(t_s, estimate.force, loads))


SPOILED = ('wrong grams', 'swapped', 'sensor moved', 'off the gel', 'rocking')
"""Ways in which weights are put on wrongly."""


def spoiled_weights(estimate: TrialEstimate, seed: int) -> dict[str, str]:
    """Spoil one weight of the profile `weights`; return what became of each calibration.

    Args:
        estimate: Estimate of a sound trial.
        seed: Fixes which weight it is, and how much.

    Returns:
        `refused`, `flagged` (a load is doubtful) or `accepted` for each of `SPOILED`. Wrong grams
        are half as many again, or two thirds; a sensor that moved has another zero from a load on,
        by 0.05 to 0.2 N; a load off the gel reaches it with a tenth of its weight; one that rocks
        swings by 15 to 30 % at 0.8 to 2.5 Hz.
    """
    rng = np.random.default_rng(seed)
    gain = calibrate_by_weights(estimate, seed).gain
    # The synchronising impulses are contacts as well, the first and the last.
    on = np.diff(np.concatenate([[0], estimate.known > 0.01, [0]]).astype(np.int8))
    edges = np.flatnonzero(on).reshape(-1, 2)
    spans = edges[np.argsort(edges[:, 0] - edges[:, 1])[: len(WEIGHTS_G)]]
    load = int(rng.integers(len(WEIGHTS_G)))
    begin, end = spans[np.argsort(spans[:, 0])][load].tolist()
    named = {name: list(WEIGHTS_G) for name in SPOILED}
    forces = {name: estimate.force.copy() for name in SPOILED}
    named['wrong grams'][load] *= 1.5 ** rng.choice((-1.0, 1.0))
    other = (load + 1) % len(WEIGHTS_G)
    swapped = named['swapped']
    swapped[load], swapped[other] = swapped[other], swapped[load]
    forces['sensor moved'][begin:] += rng.choice((-1.0, 1.0)) * rng.uniform(0.05, 0.2) / gain
    forces['off the gel'][begin:end] *= 0.1
    turns = rng.uniform(0.8, 2.5) * 1e-6 * (estimate.t_us[begin:end] - estimate.t_us[begin])
    swing = rng.uniform(0.15, 0.3) * np.sin(2.0 * np.pi * turns)
    forces['rocking'][begin:end] *= 1.0 + swing
    found = {}
    for name in SPOILED:
        try:
            spoiled = replace(estimate, force=forces[name])
            points = calibrate_by_weights(spoiled, seed, named[name]).points
            found[name] = 'flagged' if any(each.doubtful for each in points) else 'accepted'
        except ForceCalibrationError:
            found[name] = 'refused'
    return found


def _adapted(model: Model, presses: list[TrialSource]) -> tuple[Any, str]:
    """Return the adapted network and the kind of adaptation; the model itself if refused."""
    network = network_of(model)
    material = gather_presses(network, (each.load() for each in presses))
    try:
        adapted = adapt(network, material.presses)
    except CalibrationError as error:
        return network, f'refused: {error}'
    return adapted.network, adapted.way


def adaptation(
    model: ModelName = DEFAULT_MODEL,
    sensors: Annotated[int, typer.Option(min=1, help='Number of unseen sensors.')] = 6,
    out: Annotated[Path, typer.Option(help='Folder for stored trials.')] = Path('runs/models'),
    json: JsonFile = None,
) -> None:
    """Test a model on unseen simulated sensors: unchanged, with a gain, and adapted."""
    torch.set_num_threads(1)
    console = Console(markup=False)
    found = adaptation_study(read_model(find_model(model)), sensors, out / 'trials', console.print)
    rows = {name: found[name] for name in (BEFORE, WEIGHTS, ONE_GAIN, ADAPTED)}
    show_figures(console, f'dynamic trials of {sensors} unseen sensors, simulated', rows)
    console.print(f'adapted by: {", ".join(found["ways"])}')
    if found['refused']:
        console.print(f'known weights refused, gain 1 taken: {found["refused"]} sensors')
    console.print(f'spoiled weights: {found["spoiled"]}')
    write_json(json, {'model': model, 'sensors': sensors, 'simulated': True} | found)
