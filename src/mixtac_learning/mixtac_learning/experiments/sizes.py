# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""How much an experiment computes: numbers and lengths of trials, and training settings.

The numbers are in `sizes.yaml`: `quick` takes minutes and shows that everything runs; `full` gives
the published results on a CPU; `native` trains the networks of the paper at full resolution on a
GPU.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mixtac_learning.train.config import OURS, DataConfig, RunConfig
from mixtac_node.files import read_data, structure

PRESET = 'paper_like'
"""Difficulty preset of the simulated sensors."""
DYNAMIC, STATIC, HOLD, IMPACT = 'dynamic', 'static', 'long_term', 'impact'
"""Force profiles of the test trials."""

FGER, FRAMES, EVENTS, FUSION = 'fger', 'frames', 'events', 'fusion'
"""The paper's networks."""
CONSTANT, BOUND = 'constant', 'all_but_stiffness'
UNTRAINED = frozenset({CONSTANT, BOUND})
"""Rows that need no training: the best constant, and `StiffnessBound`."""
PAPER, OTHER_DAYS = 'paper', 'other_days'
PROTOCOLS = (PAPER, OTHER_DAYS)
"""One session of one sensor, its trials split 8:2 at random, as in the paper; or trained on some
days of a sensor and tested on others."""
OURS_MANY = 'ours_many_sensors'
ROWS = (
    *(CONSTANT, FRAMES, 'frames_reference', EVENTS, FUSION, 'fusion_reference'),
    *(FGER, 'fger_reference', 'fger_reference_flow', OURS, 'without_reference', OURS_MANY, BOUND),
)
"""Models of the table, in order."""


@dataclass(frozen=True, slots=True)
class Sizes:
    """Numbers and lengths of trials, and training settings.

    Attributes:
        name: Name of this set of sizes.
        trials: Training trials of each sensor.
        seconds: Length of a training trial [s].
        mix: Force profiles of the training trials, in turn.
        tests: Number and length [s] of the test trials by profile.
        paper_network: Differences from the paper's network sizes.
        paper_training: Differences from the paper's training settings.
        our_training: Training settings of our network.
        many_training: Differences for the model that is trained on many sensors.
        sensors: Sensors of that model, one trial each.
        unseen: Test sensors that no training uses; 0 for none, and no mismatches either.
        session: Number and length [s] of the trials of the protocol `paper`, by profile.
        session_training: Differences of the training by that protocol, for networks of the `paper`
            and for `ours`.
        tones_hz: Vibration frequencies [Hz].
        fast_tones_hz: Vibration frequencies above those of the paper [Hz].
        grasps: Number of slip trials by object.
        latency_seconds: Length of the real-time run in which latency is measured [s].
    """

    name: str
    trials: int
    seconds: float
    mix: tuple[str, ...]
    tests: dict[str, tuple[int, float]]
    paper_network: dict[str, Any]
    paper_training: dict[str, Any]
    our_training: dict[str, Any]
    many_training: dict[str, Any] = field(default_factory=dict)
    sensors: int = 0
    unseen: int = 0
    session: dict[str, tuple[int, float]] = field(default_factory=dict)
    session_training: dict[str, dict[str, Any]] = field(default_factory=dict)
    tones_hz: tuple[float, ...] = ()
    fast_tones_hz: tuple[float, ...] = ()
    grasps: dict[str, int] = field(default_factory=dict)
    latency_seconds: float = 5.0


@dataclass(frozen=True, slots=True)
class Variant:
    """A variant of a model.

    Attributes:
        model: The model.
        network: Differences in its network.
        training: Differences in its training.
    """

    model: str
    network: dict[str, Any] = field(default_factory=dict)
    training: dict[str, Any] = field(default_factory=dict)


_PATH = Path(__file__).with_name('sizes.yaml')
_TABLES = read_data(_PATH)


def _sizes(table: str) -> dict[str, Sizes]:
    return {
        name: structure({'name': name, **values}, Sizes, f'{_PATH}: {name}')
        for name, values in _TABLES[table].items()
    }


def _variants(table: str) -> dict[str, Variant]:
    return {name: structure(v, Variant, f'{_PATH}: {name}') for name, v in _TABLES[table].items()}


PAPER_SIZES = _sizes('paper')
"""Sizes of the experiments of the paper."""
FULL, QUICK = PAPER_SIZES['full'], PAPER_SIZES['quick']
TABLE_SIZES = _sizes('table')
"""Sizes of the table of all models (`mixtac experiments models --size`)."""
CHOICES = _variants('choices')
"""Our network with one design choice undone."""
VARIANTS = _variants('variants') | CHOICES
ALL_ROWS = tuple(dict.fromkeys((*ROWS, *VARIANTS)))


def run_config(sizes: Sizes, model: str, seed: int, data: DataConfig) -> RunConfig:
    """Return the training run of a model.

    Args:
        sizes: Training settings.
        model: One of `ALL_ROWS`.
        seed: Seed of initial weights and order.
        data: Training trials.
    """
    base = OURS if model in {OURS_MANY} | UNTRAINED else model
    variant = VARIANTS.get(model, Variant(base))
    ours = variant.model == OURS
    training = sizes.our_training if ours else sizes.paper_training
    if data.simulated is not None and data.simulated.session:
        training = training | sizes.session_training.get(OURS if ours else PAPER, {})
    if model == OURS_MANY:
        training = training | sizes.many_training
    return RunConfig(
        model=variant.model,
        network=variant.network if ours else sizes.paper_network | variant.network,
        training=training | variant.training | {'seed': seed},
        data=data,
    )
