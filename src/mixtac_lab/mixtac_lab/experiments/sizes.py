# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""How much an experiment computes: numbers and lengths of trials, and training settings.

`quick` takes minutes and shows that everything runs; `full` gives the published results on a CPU;
`native` trains the networks of the paper at full resolution on a GPU.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

from mixtac_learning.train.config import OURS, DataConfig, RunConfig

PRESET = 'paper_like'
"""Difficulty preset of the simulated sensors."""
DYNAMIC, STATIC, HOLD, IMPACT = 'dynamic', 'static', 'long_term', 'impact'
"""Force profiles of the test trials."""
IMPACT_S = 4.5
"""Length of a test trial with an impact [s]."""

FGER, FRAMES, EVENTS, FUSION = 'fger', 'frames', 'events', 'fusion'
"""The paper's networks."""
CONSTANT, BOUND = 'constant', 'all_but_stiffness'
UNTRAINED = frozenset({CONSTANT, BOUND})
"""Rows that need no training: the best constant, and `StiffnessBound`."""
OURS_MANY = 'ours_many_sensors'
ROWS = (CONSTANT, FRAMES, EVENTS, FUSION, FGER, OURS, OURS_MANY, BOUND)
"""Models of the table, in order."""
CHOICES: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    'without_reference': ({'frame_channels': ('frame',)}, {}),
    'without_frame_flow': ({'frame_channels': ('difference',)}, {}),
    'counts_for_flow': ({'gradient_flow': False}, {}),
    'correction_at_arrival': ({'correction_point': 'arrival'}, {}),
    'without_shortcut': ({'event_shortcut': False}, {}),
    'without_blows': ({}, {'blow_every': 0, 'force_weight': 0.0}),
}
"""Our network with one design choice undone: differences in the network and in its training."""
ALL_ROWS = (*ROWS, *CHOICES)

REDUCED_NETWORK = {'scale': 8, 'events_per_packet': 64}
REDUCED_TRAINING = {'epochs': 16, 'batch': 32, 'rate': 5e-4}
"""The paper's networks and training, reduced to what a CPU trains in minutes."""
OUR_TRAINING = {
    'frame_epochs': 20,
    'recurrent_epochs': 24,
    'joint_epochs': 3,
    'force_weight': 10.0,
}
OUR_LONG_TRAINING = OUR_TRAINING | {'recurrent_epochs': 40, 'joint_epochs': 6, 'blow_every': 8}


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
        unseen: Test sensors that no training uses.
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
    tones_hz: tuple[float, ...] = ()
    fast_tones_hz: tuple[float, ...] = ()
    grasps: dict[str, int] = field(default_factory=dict)
    latency_seconds: float = 5.0


FULL = Sizes(
    name='full',
    trials=16,
    seconds=8.0,
    mix=(DYNAMIC, STATIC, IMPACT, 'press', DYNAMIC, HOLD, STATIC, IMPACT),
    tests={DYNAMIC: (4, 20.0), STATIC: (6, 25.0), HOLD: (4, 25.0), IMPACT: (6, IMPACT_S)},
    paper_network=REDUCED_NETWORK,
    paper_training=REDUCED_TRAINING,
    our_training=OUR_TRAINING,
    tones_hz=(50.0, 70.0, 90.0, 110.0, 130.0, 150.0, 170.0, 190.0, 210.0, 230.0, 250.0),
    fast_tones_hz=(290.0, 330.0, 370.0, 410.0, 450.0),
    grasps={'cup': 20, 'box': 15, 'ball': 20},
    latency_seconds=10.0,
)
"""At most an hour on two CPU cores for all experiments and three seeds."""
QUICK = replace(
    FULL,
    name='quick',
    trials=2,
    seconds=4.0,
    tests={DYNAMIC: (1, 5.0), STATIC: (1, 5.0), HOLD: (1, 6.0), IMPACT: (1, IMPACT_S)},
    paper_network={'scale': 16, 'events_per_packet': 16},
    paper_training={'epochs': 1, 'batch': 16, 'rate': 5e-4},
    our_training=OUR_TRAINING | {'frame_epochs': 6, 'recurrent_epochs': 2, 'joint_epochs': 1},
    tones_hz=(70.0, 230.0),
    fast_tones_hz=(330.0,),
    grasps={'box': 1},
    latency_seconds=3.0,
)
"""Minutes; shows that everything works, its results mean nothing."""
TABLE_FULL = Sizes(
    name='full',
    trials=24,
    seconds=8.0,
    mix=(DYNAMIC, STATIC, IMPACT, 'press', DYNAMIC, 'oscillation', STATIC, IMPACT),
    tests={DYNAMIC: (4, 20.0), STATIC: (4, 20.0), HOLD: (4, 25.0), IMPACT: (4, IMPACT_S)},
    paper_network={'scale': 4, 'events_per_packet': 128},
    paper_training={},
    our_training=OUR_LONG_TRAINING,
    many_training={
        'frame_epochs': 16,
        'recurrent_epochs': 60,
        'recurrent_rate': 2e-3,
        'joint_epochs': 4,
    },
    sensors=96,
    unseen=12,
)
"""The paper's training at a quarter of the resolution, for a CPU and some hours."""
TABLE_SIZES = {
    'full': TABLE_FULL,
    'reduced': replace(
        TABLE_FULL,
        name='reduced',
        paper_network=REDUCED_NETWORK,
        paper_training=REDUCED_TRAINING,
    ),
    'native': replace(TABLE_FULL, name='native', paper_network={}),
    'quick': replace(
        TABLE_FULL,
        name='quick',
        trials=4,
        seconds=5.0,
        tests={DYNAMIC: (1, 6.0), STATIC: (1, 6.0), HOLD: (1, 6.0), IMPACT: (1, IMPACT_S)},
        paper_network=REDUCED_NETWORK,
        paper_training={'epochs': 2, 'batch': 32},
        our_training=OUR_TRAINING | {'frame_epochs': 12, 'recurrent_epochs': 4, 'joint_epochs': 1},
        many_training={},
        sensors=4,
        unseen=1,
    ),
}
"""Sizes of the table of all models (`mixtac experiments models --size`).

`reduced` trains the paper's networks as the experiments of the paper do on a CPU, `native` at
native resolution and full size on a GPU.
"""


def run_config(sizes: Sizes, model: str, seed: int, data: DataConfig) -> RunConfig:
    """Return the training run of a model.

    Args:
        sizes: Training settings.
        model: One of `ALL_ROWS`.
        seed: Seed of initial weights and order.
        data: Training trials.
    """
    ours = model in {OURS, OURS_MANY, *CHOICES} | UNTRAINED
    training = sizes.our_training if ours else sizes.paper_training
    if model == OURS_MANY:
        training = training | sizes.many_training
    network, changed = CHOICES.get(model, ({} if ours else sizes.paper_network, {}))
    return RunConfig(
        model=OURS if ours else model,
        network=network,
        training=training | changed | {'seed': seed},
        data=data,
    )
