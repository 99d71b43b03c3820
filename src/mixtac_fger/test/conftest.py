# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A toy trial and a model with random weights; makes the helpers beside the tests importable."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from mixtac_fger.config import FgerConfig

sys.path.insert(0, str(Path(__file__).parent))

from toy_sensor import ToyTrial, random_model, toy_trial

if TYPE_CHECKING:
    from mixtac_fger.weights import Model


@pytest.fixture(scope='session')
def trial() -> ToyTrial:
    return toy_trial(1.2, seed=3)


@pytest.fixture(scope='session')
def config() -> FgerConfig:
    return FgerConfig()


@pytest.fixture(scope='session')
def model(config: FgerConfig) -> Model:
    return random_model(config)
