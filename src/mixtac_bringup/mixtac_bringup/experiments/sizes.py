# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""How large the experiments are."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

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
