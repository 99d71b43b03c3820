# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What stays unknown to one who sees everything: the modulus, or only that of the day."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np
import pytest

from mixtac_events.arrays import Events
from mixtac_lab.experiments.studies.models import StiffnessBound
from mixtac_learning.trials.trial import ForceLabel, TrialArrays
from mixtac_sim.world import training_trials as generation
from mixtac_sim.world.device import draw_conditions, draw_device
from mixtac_sim.world.effects import preset
from mixtac_sim.world.training_trials import TrialSpec

SPEC = TrialSpec(810_003, 820_003, 'dynamic', 1.0, 'paper_like')


def trial_of(spec: TrialSpec) -> TrialArrays:
    t_us = np.arange(0.0, 1e6, 1000.0)
    label = ForceLabel(t_us, 0.5 + 0.5 * np.sin(t_us / 1e5))
    arrival = np.arange(20, dtype=np.int64) * 40_000 + 40_000
    return TrialArrays(
        events=Events.empty(),
        frames=np.zeros((20, 260, 346), np.uint16),
        exposure_start_us=arrival - 30_000,
        exposure_end_us=arrival - 24_000,
        arrival_us=arrival,
        truth=label,
        reference=None,
        origin=asdict(spec) | {'name': spec.name, 'simulated': True},
    )


def test_of_an_unknown_sensor_modulus_and_day_are_missing():
    found = StiffnessBound(frozenset())(trial_of(SPEC))
    chosen = preset(SPEC.preset)
    modulus = draw_device(SPEC.device_seed, chosen).layer.modulus_kpa
    day = draw_conditions(SPEC.trial_seed, chosen).stiffness
    # 160 kPa is the middle of what the simulator draws (Shore A-5).
    assert found.force == pytest.approx(found.known * 160.0 / (modulus * day))
    assert abs(np.log(modulus / 160.0)) > 0.2


def test_of_a_known_sensor_only_the_day_is_missing():
    found = StiffnessBound(frozenset({SPEC.device_seed}))(trial_of(SPEC))
    low, high = preset(SPEC.preset).gel.day
    ratio = found.force / found.known
    assert np.ptp(ratio) < 1e-9
    assert 1.0 / high <= ratio[0] <= 1.0 / low
    assert ratio[0] != 1.0


def test_usual_is_the_middle_of_many_sensors():
    factors = [generation.stiffness(replace(SPEC, device_seed=seed)) for seed in range(30)]
    assert abs(np.median(np.log(factors))) < 0.15
    assert 0.15 < np.std(np.log(factors)) < 0.4
