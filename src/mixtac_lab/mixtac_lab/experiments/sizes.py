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
OURS_MANY, FGER_AS_STATED = 'ours_many_sensors', 'fger_as_stated'
_REFERENCE = {'light': 'reference', 'norm': 'batch'}
_REFERENCE_FLOW = {'light': 'reference_flow', 'norm': 'batch'}
Changes = dict[str, tuple[str, dict[str, Any], dict[str, Any]]]
"""By name: a model, and the differences in its network and in its training."""
PAPER_CHOICES: Changes = {
    'frames_reference': (FRAMES, _REFERENCE, {}),
    'fusion_reference': (FUSION, _REFERENCE, {}),
    'fger_reference': (FGER, _REFERENCE, {}),
    'frames_reference_flow': (FRAMES, _REFERENCE_FLOW, {}),
    'fger_reference_flow': (FGER, _REFERENCE_FLOW, {}),
    'fger_continuous': (FGER, {'correction': 'continuous'}, {}),
    'fger_periodic': (FGER, {'correction': 'periodic'}, {}),
    'fger_batch_norm': (FGER, {'norm': 'batch'}, {}),
    'fger_relative': (FGER, {'light': 'relative'}, {}),
    FGER_AS_STATED: (
        FGER,
        {'norm': 'batch'},
        {
            'frame_epochs': 0,
            'event_epochs': 0,
            'recurrent_epochs': 0,
            'joint_epochs': 50,
            'joint_rate': 1e-4,
            'schedule': 'constant',
            # 128 cycles: 8 of each of 16 trials.
            'cycles': 8,
            'group_trials': 16,
            'force_weight': 0.0,
            'patience': 0,
        },
    ),
}
"""The paper's networks with the reference, with one choice undone, and with nothing but the paper's
text."""
CHOICES: Changes = {
    'without_reference': (OURS, {'frame_channels': ('frame',)}, {}),
    'without_frame_flow': (OURS, {'frame_channels': ('difference',)}, {}),
    'counts_for_flow': (OURS, {'gradient_flow': False}, {}),
    'correction_at_arrival': (OURS, {'correction_point': 'arrival'}, {}),
    'without_shortcut': (OURS, {'event_shortcut': False}, {}),
    'without_blows': (OURS, {}, {'blow_every': 0, 'force_weight': 0.0}),
}
"""Our network with one design choice undone."""
ROWS = (
    *(CONSTANT, FRAMES, 'frames_reference', EVENTS, FUSION, 'fusion_reference'),
    *(FGER, 'fger_reference', 'fger_reference_flow', OURS, 'without_reference', OURS_MANY, BOUND),
)
"""Models of the table, in order."""
ALL_ROWS = tuple(dict.fromkeys((*ROWS, *PAPER_CHOICES, *CHOICES)))


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


def _read(table: str) -> dict[str, Sizes]:
    path = Path(__file__).with_name('sizes.yaml')
    return {
        name: structure({'name': name, **values}, Sizes, f'{path}: {name}')
        for name, values in read_data(path)[table].items()
    }


PAPER_SIZES = _read('paper')
"""Sizes of the experiments of the paper."""
FULL, QUICK = PAPER_SIZES['full'], PAPER_SIZES['quick']
TABLE_SIZES = _read('table')
"""Sizes of the table of all models (`mixtac experiments models --size`)."""
TABLE_FULL = TABLE_SIZES['full']


def run_config(sizes: Sizes, model: str, seed: int, data: DataConfig) -> RunConfig:
    """Return the training run of a model.

    Args:
        sizes: Training settings.
        model: One of `ALL_ROWS`.
        seed: Seed of initial weights and order.
        data: Training trials.
    """
    base = OURS if model in {OURS_MANY} | UNTRAINED else model
    base, network, changed = (PAPER_CHOICES | CHOICES).get(model, (base, {}, {}))
    training = sizes.our_training if base == OURS else sizes.paper_training
    if data.simulated is not None and data.simulated.session:
        training = training | sizes.session_training.get(OURS if base == OURS else PAPER, {})
    if model == OURS_MANY:
        training = training | sizes.many_training
    return RunConfig(
        model=base,
        network=network if base == OURS else sizes.paper_network | network,
        training=training | changed | {'seed': seed},
        data=data,
    )
