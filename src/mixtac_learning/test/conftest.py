# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Toy trials, and FGER-Net with random weights; makes helpers of tests importable."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import torch

from mixtac_fger.config import FgerConfig
from mixtac_learning.network import network_of
from mixtac_learning.train.sequences import Sequences, stack
from mixtac_learning.trials.samples import make_sample
from mixtac_learning.trials.trial import ForceLabel, TrialArrays

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[2] / 'mixtac_fger' / 'test'))

from toy_sensor import random_model, toy_trial

if TYPE_CHECKING:
    from mixtac_fger.weights import Model
    from mixtac_learning.network import FgerNetwork


def toy_arrays(seconds: float, seed: int) -> TrialArrays:
    """Return a trial of the toy sensor; its reference is 10 mN off."""
    toy = toy_trial(seconds, seed)
    return TrialArrays(
        *toy[:5],
        truth=ForceLabel(toy.t_us, toy.force),
        reference=ForceLabel(toy.t_us, toy.force + 0.01),
        origin={'name': f'toy-{seed}', 'device_seed': seed},
    )


@pytest.fixture(scope='session', autouse=True)
def one_thread() -> None:
    """Small networks on a busy machine: threads wait for each other longer than they help."""
    torch.set_num_threads(1)


@pytest.fixture(scope='session')
def trial() -> TrialArrays:
    return toy_arrays(1.2, seed=3)


@pytest.fixture(scope='session')
def config() -> FgerConfig:
    return FgerConfig()


@pytest.fixture(scope='session')
def model(config: FgerConfig) -> Model:
    return random_model(config)


@pytest.fixture(scope='session')
def network(model: Model) -> FgerNetwork:
    return network_of(model)


@pytest.fixture(scope='session')
def toy_sequences(config: FgerConfig) -> list[Sequences]:
    """Two sets of toy trials: five to train on and two others."""
    trials = [toy_arrays(1.6, seed) for seed in range(7)]
    samples = [make_sample(config, trial) for trial in trials]
    return [stack(samples[:5]), stack(samples[5:])]
