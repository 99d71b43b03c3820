# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What adaptation is worth: simulated sensors that no training used, before and after."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from mixtac_fger.adapt.adaptation import adapt
from mixtac_fger.adapt.material import gather_presses
from mixtac_fger.errors import CalibrationError
from mixtac_fger.experiments.suite import FULL, unseen_specs
from mixtac_fger.judge.estimators import StreamingEstimator
from mixtac_fger.judge.judging import judge_sources, sensor_scales
from mixtac_fger.judge.summary import summarise
from mixtac_fger.trials.simulated_source import SimulatedSource
from mixtac_fger.trials.trial_cache import CachedSource
from mixtac_fger.weights import LoadedModel

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from mixtac_fger.trial_plan import TrialSpec
    from mixtac_fger.trials.trial_source import TrialSource

BEFORE, ONE_GAIN, ADAPTED = 'before', 'one_gain', 'adapted'
PRESSES = 3
"""Recordings to adapt by, of 8 s each: the press that the one gain comes from, and others."""


def adaptation_study(
    model: LoadedModel, sensors: int, cache: Path, say: Callable[[str], None]
) -> dict[str, Any]:
    """Judge a model on sensors that no training used, in three states.

    Args:
        model: Network with its weights.
        sensors: How many.
        cache: Where trials are kept.
        say: Called with what is done now.

    Returns:
        `before`, `one_gain` (from one press of 8 s) and `adapted` (by `PRESSES` recordings): what
        `summarise` gives, and `sensor_mae`, one value per sensor; `ways`: what was chosen.
    """

    def cached(spec: TrialSpec) -> TrialSource:
        return CachedSource(SimulatedSource(spec), cache)

    chosen = replace(FULL, unseen=sensors)
    found: dict[str, list[Any]] = {name: [] for name in (BEFORE, ONE_GAIN, ADAPTED)}
    ways: list[str] = []
    for test, press in zip(*unseen_specs(chosen), strict=True):
        say(f'sensor {test.device_seed}')
        seeds = [press.trial_seed + 10_000 * number for number in range(PRESSES)]
        presses = [cached(replace(press, trial_seed=seed)) for seed in seeds]
        estimator = StreamingEstimator(model)
        raw = judge_sources(estimator, [cached(test)]).estimates
        scales = sensor_scales(estimator, presses[:1], fallback=1.0)
        network, way = _adapted(model, presses)
        ways.append(way)
        found[BEFORE] += raw
        found[ONE_GAIN] += [each.scaled(scales[each.device]) for each in raw]
        after = StreamingEstimator(LoadedModel(network, model.card))
        found[ADAPTED] += judge_sources(after, [cached(test)]).estimates
    rows: dict[str, Any] = {
        name: summarise(estimates) | {'sensor_mae': _each(estimates)}
        for name, estimates in found.items()
    }
    return rows | {'ways': ways}


def _adapted(model: LoadedModel, presses: list[TrialSource]) -> tuple[Any, str]:
    """Return the adapted network and what was chosen; the model itself where it is refused."""
    material = gather_presses(model.network, (each.load() for each in presses))
    try:
        adapted = adapt(model.network, material.presses)
    except CalibrationError as error:
        return model.network, f'refused: {error}'
    return adapted.network, adapted.way


def _each(estimates: list[Any]) -> list[float]:
    return [round(float(np.mean(np.abs(e.force - e.known))), 4) for e in estimates]
