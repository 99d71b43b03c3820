# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Toy trials, and FGER-Net with random weights; makes helpers of tests importable."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import torch

from mixtac_fger.config import FgerConfig
from mixtac_learning.network import network_of
from mixtac_learning.train.sequences import DiskGroups, Sequences
from mixtac_learning.trials.samples import Sample, make_sample, save_sample
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
def toy_samples(config: FgerConfig) -> list[Sample]:
    """Seven trials, each of another sensor."""
    return [make_sample(config, toy_arrays(1.6, seed)) for seed in range(7)]


@pytest.fixture(scope='session')
def toy_groups(toy_samples: list[Sample], tmp_path_factory: Any) -> list[DiskGroups]:
    """Two groups of toy trials: five to train on and two others."""
    folder = tmp_path_factory.mktemp('toy')
    for number, sample in enumerate(toy_samples):
        save_sample(folder / str(number), sample)
    paths = [folder / str(number) for number in range(7)]
    return [DiskGroups(paths[:5], 5), DiskGroups(paths[5:], 2)]


@pytest.fixture
def toy_sequences(toy_groups: list[DiskGroups]) -> list[Sequences]:
    return [each.load(0) for each in toy_groups]
