# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""How much an experiment computes: numbers and lengths of trials, and training settings.

`quick` takes minutes and shows that everything runs; `full` gives the published results on a CPU;
`native` trains the networks of the paper at full resolution on a GPU.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

from mixtac_learning.train.config import OURS, DataConfig, RunConfig, SimulatedData
from mixtac_sim.world.training_trials import TrialSpec

PRESET = 'paper_like'
"""How hard the simulated sensors are."""
DYNAMIC, STATIC, HOLD, IMPACT = 'dynamic', 'static', 'long_term', 'impact'
"""Force profiles that models are judged on."""
TRAINED = (DYNAMIC, STATIC, IMPACT, 'press', DYNAMIC, HOLD, STATIC, IMPACT)
"""Profiles of the training trials, in turn."""


@dataclass(frozen=True, slots=True)
class Sizes:
    """Numbers and lengths.

    Attributes:
        name: Of the set of sizes.
        trials: Training trials of each sensor.
        seconds: Length of a training trial [s].
        tests: Number and length [s] of the trials that models are judged on, by profile.
        paper_network: What differs from the network as the paper sizes it.
        paper_training: What differs from the paper's protocol.
        our_training: Settings of the small network's training.
        tones_hz: Tones of the vibration [Hz].
        fast_tones_hz: Those beyond the paper's [Hz].
        grasps: Slip trials by object.
        latency_seconds: Length of the run in real time that latency is measured in [s].
    """

    name: str
    trials: int
    seconds: float
    tests: dict[str, tuple[int, float]]
    paper_network: dict[str, Any]
    paper_training: dict[str, Any]
    our_training: dict[str, Any]
    tones_hz: tuple[float, ...]
    fast_tones_hz: tuple[float, ...]
    grasps: dict[str, int] = field(default_factory=dict)
    latency_seconds: float = 5.0


FULL = Sizes(
    name='full',
    trials=16,
    seconds=8.0,
    tests={DYNAMIC: (4, 20.0), STATIC: (6, 25.0), HOLD: (4, 25.0), IMPACT: (6, 4.5)},
    paper_network={'scale': 8, 'events_per_packet': 64},
    paper_training={'epochs': 16, 'batch': 32, 'rate': 5e-4},
    our_training={
        'frame_epochs': 20,
        'recurrent_epochs': 24,
        'joint_epochs': 3,
        'force_weight': 10.0,
    },
    tones_hz=(50.0, 70.0, 90.0, 110.0, 130.0, 150.0, 170.0, 190.0, 210.0, 230.0, 250.0),
    fast_tones_hz=(290.0, 330.0, 370.0, 410.0, 450.0),
    grasps={'cup': 20, 'box': 15, 'ball': 20},
    latency_seconds=10.0,
)
"""At most an hour on two CPU cores for all experiments and three seeds."""
QUICK = Sizes(
    name='quick',
    trials=2,
    seconds=4.0,
    tests={DYNAMIC: (1, 5.0), STATIC: (1, 5.0), HOLD: (1, 6.0), IMPACT: (1, 4.5)},
    paper_network={'scale': 16, 'events_per_packet': 16},
    paper_training={'epochs': 1, 'batch': 16, 'rate': 5e-4},
    our_training={
        'frame_epochs': 6,
        'recurrent_epochs': 2,
        'joint_epochs': 1,
        'force_weight': 10.0,
    },
    tones_hz=(70.0, 230.0),
    fast_tones_hz=(330.0,),
    grasps={'box': 1},
    latency_seconds=3.0,
)
"""Minutes; shows that everything works, its figures mean nothing."""
CONSTANT, BOUND = 'constant', 'all_but_stiffness'
UNTRAINED = frozenset({CONSTANT, BOUND})
"""Rows that no seed changes: the best constant, and what `StiffnessBound` says."""
OURS_MANY = 'ours_many_sensors'
ROWS = (CONSTANT, 'frames', 'events', 'fusion', 'fger', OURS, OURS_MANY, BOUND)
"""Models in the order of the table."""
CHOICES: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    'without_reference': ({'frame_channels': ('frame',)}, {}),
    'without_frame_flow': ({'frame_channels': ('difference',)}, {}),
    'counts_for_flow': ({'gradient_flow': False}, {}),
    'correction_at_arrival': ({'correction_point': 'arrival'}, {}),
    'without_shortcut': ({'event_shortcut': False}, {}),
    'without_blows': ({}, {'blow_every': 0, 'force_weight': 0.0}),
}
"""Ours with one choice undone at a time: what differs in network and in training."""
ALL_ROWS = (*ROWS, *CHOICES)
"""All that can be trained and judged, in order."""
_FIRST_TRIAL = 800_000
"""Trial seeds of the tests; training uses 100,000 to 200,000."""
_FIRST_DEVICE = 810_000
_PRESET = 'paper_like'


@dataclass(frozen=True, slots=True)
class Suite:
    """Sizes of the experiment.

    Attributes:
        trials: Trials of the one sensor that the models are trained on.
        sensors: Sensors of the model that is trained on many, with one trial each.
        seconds: Length of a training trial.
        tests: Test trials per profile.
        test_seconds: Length of a test trial, but for impacts and long holds.
        hold_seconds: Length of a long hold.
        unseen: Sensors that no training used.
        paper_network: Size of the paper's networks.
        paper_training: Their protocol, where it differs.
        our_training: Ours.
        many_training: What differs for the model that is trained on many sensors.
    """

    trials: int
    sensors: int
    seconds: float
    tests: int
    test_seconds: float
    hold_seconds: float
    unseen: int
    paper_network: dict[str, Any]
    paper_training: dict[str, Any]
    our_training: dict[str, Any]
    many_training: dict[str, Any]


TABLE_FULL = Suite(
    trials=24,
    sensors=96,
    seconds=8.0,
    tests=4,
    test_seconds=20.0,
    hold_seconds=25.0,
    unseen=12,
    paper_network={'scale': 4, 'events_per_packet': 128},
    paper_training={},
    our_training={
        'frame_epochs': 20,
        'recurrent_epochs': 40,
        'joint_epochs': 6,
        'force_weight': 10.0,
        'blow_every': 8,
    },
    many_training={
        'frame_epochs': 16,
        'recurrent_epochs': 60,
        'recurrent_rate': 2e-3,
        'joint_epochs': 4,
    },
)
"""The paper's protocol at a quarter of the resolution, for a CPU and some hours."""
TABLE_REDUCED = replace(
    TABLE_FULL,
    paper_network={'scale': 8, 'events_per_packet': 64},
    paper_training={'epochs': 16, 'batch': 32, 'rate': 5e-4},
)
"""The paper's networks as the experiments of the paper train them on a CPU; ours as in FULL."""
TABLE_NATIVE = replace(TABLE_FULL, paper_network={})
"""The same at native resolution and full size, for a GPU."""
TABLE_QUICK = Suite(
    trials=4,
    sensors=4,
    seconds=5.0,
    tests=1,
    test_seconds=6.0,
    hold_seconds=6.0,
    unseen=1,
    paper_network={'scale': 8, 'events_per_packet': 64},
    paper_training={'epochs': 2, 'batch': 32},
    our_training={
        'frame_epochs': 12,
        'recurrent_epochs': 4,
        'joint_epochs': 1,
        'force_weight': 10.0,
    },
    many_training={},
)
"""Minutes; shows that it works, its figures mean nothing."""
TABLE_SIZES = {
    'full': TABLE_FULL,
    'reduced': TABLE_REDUCED,
    'native': TABLE_NATIVE,
    'quick': TABLE_QUICK,
}
TABLE_PROFILES = (
    'dynamic',
    'static',
    'impact',
    'press',
    'dynamic',
    'oscillation',
    'static',
    'impact',
)
"""Of the trials that are trained on, in turn."""


def table_run_config(suite: Suite, model: str, seed: int, cache: str) -> RunConfig:
    """Return the training run of a model; the trials are the same for every seed."""
    many = model == OURS_MANY
    count = suite.sensors if many else suite.trials
    simulated = SimulatedData(_PRESET, count if many else 1, count, suite.seconds, TABLE_PROFILES)
    ours = model in {OURS, OURS_MANY, *CHOICES} | UNTRAINED
    training = suite.our_training if ours else suite.paper_training
    if many:
        training = training | suite.many_training
    network, changed = CHOICES.get(model, ({} if ours else suite.paper_network, {}))
    return RunConfig(
        model=OURS if ours else model,
        network=network,
        training=training | changed | {'seed': seed},
        data=DataConfig(simulated=simulated, cache=cache, checked=_held_out(ours, many)),
    )


def _held_out(ours: bool, many: bool) -> float:
    """Return which part of the trials a model keeps back to calibrate its uncertainty by.

    Every seventh of one sensor's trials, every ninth of many sensors': profiles take turns of
    eight, so that what is kept back differs.
    """
    if not ours:
        return 0.0
    return 1 / 9 if many else 1 / 7


def test_specs(suite: Suite, device: int) -> list[TrialSpec]:
    """Return the test trials on the sensor that was trained on: other days, whole trials."""
    lengths = {
        'dynamic': suite.test_seconds,
        'static': suite.test_seconds,
        'long_term': suite.hold_seconds,
        'impact': 4.5,
    }
    return [
        TrialSpec(device, _FIRST_TRIAL + 100 * row + column, profile, seconds, _PRESET)
        for column, (profile, seconds) in enumerate(lengths.items())
        for row in range(suite.tests)
    ]


def unseen_specs(suite: Suite) -> tuple[list[TrialSpec], list[TrialSpec]]:
    """Return dynamic trials of sensors that no training used, and one press of each."""
    devices = range(_FIRST_DEVICE, _FIRST_DEVICE + suite.unseen)
    seconds = suite.test_seconds
    return (
        [TrialSpec(d, d + 10_000, 'dynamic', seconds, _PRESET) for d in devices],
        [TrialSpec(d, d + 20_000, 'press', 8.0, _PRESET) for d in devices],
    )
