# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Which simulated trials to train on and which to judge by; the seeds never meet."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

TRAINING_PROFILES = (
    'dynamic',
    'impact',
    'press',
    'oscillation',
    'impact',
    'dynamic',
    'static',
    'demo',
)
"""Taken in turn. Impacts come twice: they are short, and a net that saw none misses them."""
EVALUATION_PROFILES = ('press', 'oscillation', 'impact', 'dynamic', 'static', 'demo')
DEFAULT_PRESET = 'easy'
"""What the shipped model was trained on."""
TRAINING_DEVICES = 100_000
"""First device seed of training; 100,000 seeds from here on are training's."""
TRAINING_TRIALS = 100_000
"""First trial seed of training."""
UNSEEN = 500_000
"""First device and trial seed of evaluation."""


@dataclass(frozen=True, slots=True)
class TrialSpec:
    """One simulated trial.

    Attributes:
        device_seed: Which sensor: beads, gel, lamp, pixels.
        trial_seed: Which day: contact point, speeds, noise, clocks.
        profile: Force profile of `mixtac_sim.profiles`.
        seconds: Length.
        preset: How hard the simulated sensor is (`mixtac_sim.presets`).
        without: One effect of the preset that is switched off, empty for none.
    """

    device_seed: int
    trial_seed: int
    profile: str
    seconds: float
    preset: str = DEFAULT_PRESET
    without: str = ''

    @property
    def name(self) -> str:
        """A file name for what belongs to the trial."""
        seeds = f'd{self.device_seed}_t{self.trial_seed}'
        kind = self.preset if not self.without else f'{self.preset}-{self.without}'
        return f'{self.profile}_{seeds}_{self.seconds:g}s_{kind}'

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as JSON-ready values."""
        return asdict(self)


SHORTEST_S = {'demo': 10.0}
"""Profiles that need some time."""


def _spec(
    device: int, trial: int, profile: str, seconds: float, preset: str = DEFAULT_PRESET
) -> TrialSpec:
    return TrialSpec(device, trial, profile, max(seconds, SHORTEST_S.get(profile, 0.0)), preset)


def training_plan(
    trials: int,
    gels: int,
    seconds: float,
    seed: int,
    preset: str = DEFAULT_PRESET,
    profiles: tuple[str, ...] = TRAINING_PROFILES,
) -> list[TrialSpec]:
    """Return `trials` trials over `gels` sensors, profiles in turn.

    Args:
        trials: Number of trials.
        gels: Number of different sensors.
        seconds: Length of a trial.
        seed: Shifts all seeds: another seed gives other sensors and other days.
        preset: How hard the simulated sensors are.
        profiles: Force profiles, in turn.
    """
    first = TRAINING_DEVICES + 1000 * (seed % 100)
    return [
        _spec(
            first + index % gels,
            TRAINING_TRIALS + 1000 * (seed % 100) + index,
            profiles[(index + (index // gels if gels > 1 else 0)) % len(profiles)],
            seconds,
            preset,
        )
        for index in range(trials)
    ]


def evaluation_plan(
    devices: list[int],
    seconds: float,
    seed: int,
    profiles: tuple[str, ...] = EVALUATION_PROFILES,
    preset: str = DEFAULT_PRESET,
) -> list[TrialSpec]:
    """Return one trial per profile and sensor with trial seeds that training never uses."""
    return [
        _spec(device, UNSEEN + 10_000 * seed + 100 * row + column, profile, seconds, preset)
        for row, device in enumerate(devices)
        for column, profile in enumerate(profiles)
    ]


def calibration_plan(
    devices: list[int], seconds: float, seed: int, preset: str = DEFAULT_PRESET
) -> list[TrialSpec]:
    """Return one more press per sensor, to calibrate it with."""
    return [
        _spec(device, UNSEEN + 10_000 * seed + 100 * row + 99, 'press', seconds, preset)
        for row, device in enumerate(devices)
    ]


def unseen_devices(count: int, seed: int) -> list[int]:
    """Return device seeds that training never uses."""
    return [UNSEEN + 1000 * seed + index for index in range(count)]
