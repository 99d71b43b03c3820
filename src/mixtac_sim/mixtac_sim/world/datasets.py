# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The named data sets, those of the paper first, and data sets of a single profile.

Trials are split into training and test 8:2, by whole trials or whole sensors, never by sample. A
digest of the simulator's source distinguishes data sets of different simulators.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import metadata
from typing import Final
from zlib import crc32

from mixtac_recordings.dataset import DatasetDescription, TrialSpec
from mixtac_sim import SimulationError
from mixtac_sim.random_streams import stream
from mixtac_sim.world.profiles import PROFILES
from mixtac_sim.world.training_trials import simulator_digest

DATASET_PRESET: Final = 'paper_like'
"""Default preset of named data sets."""
TRAIN_SHARE: Final = 0.8
"""Share of training in the paper's split (section 4.4)."""


def split_groups(count: int, seed: int) -> list[str]:
    """Return `train` or `test` for each of some groups, the same for the same arguments.

    Each side gets at least one group where there are two or more; a single one trains.

    Args:
        count: Groups: trials, or sensors with all of their trials.
        seed: Seed of the data set.
    """
    tests = round((1.0 - TRAIN_SHARE) * count)
    tests = max(tests, 1) if count > 1 else 0
    drawn = set(stream(seed, 'split').permutation(count)[:tests].tolist())
    return ['test' if group in drawn else 'train' for group in range(count)]


PACKAGE = 'mixtac_sim'


def generator_version() -> str:
    """Return the version of the package, `unknown` where it is not installed."""
    try:
        return metadata.version(PACKAGE)
    except metadata.PackageNotFoundError:
        return 'unknown'


def describe(
    name: str, seed: int, preset: str, split_by: str, trials: list[TrialSpec]
) -> DatasetDescription:
    """Return the description of trials that this simulator is about to make."""
    generator = {
        'package': PACKAGE,
        'version': generator_version(),
        'digest': simulator_digest(),
    }
    return DatasetDescription(name, seed, preset, split_by, tuple(trials), generator)


SEEDS_PER_DATASET: Final = 1_000
"""Trials and sensors of one data set and seed have seeds of their own, so many of each."""
FIRST_SEED: Final = 1_000_000
"""Data sets begin here, beyond the seeds that the shipped model was trained and judged with."""
DATASET_SEEDS: Final = 900
"""Seeds of a data set: 0 to 899. Device seeds stay below 10,000,000, the camera's serial number."""


@dataclass(frozen=True, slots=True)
class DatasetPlan:
    """Content of a named data set.

    Attributes:
        profiles: Force profiles, in turn for the trials of a sensor.
        trials: Number of trials.
        seconds: Length of each trial [s].
        devices: Number of different sensors; trials go round them.
    """

    profiles: tuple[str, ...]
    trials: int = 30
    seconds: float = 25.0
    devices: int = 1

    @property
    def split_by(self) -> str:
        """Return what goes to training or test as a whole: `trial` or `device`."""
        return 'device' if self.devices > 1 else 'trial'


DATASETS: Final = {
    # Slow presses of 0 to 1 N, held (paper, section 4.4: 30 trials of 25 s).
    'static': DatasetPlan(('static',)),
    # One hold over the whole trial, for drift (paper, section 4.2: 25 s).
    'long_term': DatasetPlan(('long_term',), trials=10),
    # Forces of 0 to 1 N at all paces; number and length as in static.
    'dynamic': DatasetPlan(('dynamic',)),
    # 20 g from 5 cm, one drop per trial, with bounces and rest (paper, section 4.5: 30 drops).
    'impact': DatasetPlan(('impact',), seconds=4.25),
    # Vibrations of 50 to 250 Hz on a press (paper, section 4.1, without the number of its trials).
    'vibration': DatasetPlan(('vibration',), seconds=10.0),
    # Ten sensors with gel, mesh, beads, lens, lamp and pixels of their own, three trials each; the
    # test sensors are never trained on.
    'new_gel': DatasetPlan(('dynamic', 'static', 'impact'), devices=10),
}
"""Data sets by name."""


def plan_dataset(name: str, seed: int = 0, preset: str = DATASET_PRESET) -> list[TrialSpec]:
    """Return the trials of a named data set.

    Args:
        name: One of `DATASETS`.
        seed: Another seed gives other sensors and other days; 0 to 899.
        preset: Difficulty preset of the sensors.

    Raises:
        SimulationError: Unknown name, or seed out of range.
    """
    if name not in DATASETS:
        raise SimulationError(f'data set {name!r} is unknown: choose one of {", ".join(DATASETS)}')
    return plan_trials(DATASETS[name], list(DATASETS).index(name), seed, preset)


def plan_profile(
    profile: str, trials: int, seconds: float, seed: int = 0, preset: str = DATASET_PRESET
) -> list[TrialSpec]:
    """Return trials of one profile on one sensor, split by trial.

    Args:
        profile: One of `mixtac_sim.world.profiles.PROFILES`.
        trials: Number of trials.
        seconds: Length of each trial [s].
        seed: Another seed gives another sensor and other days; 0 to 899.
        preset: Difficulty preset of the sensors.

    Raises:
        SimulationError: Unknown profile, or a number out of range.
    """
    if profile not in PROFILES:
        known = ', '.join(sorted(PROFILES))
        raise SimulationError(f'profile {profile!r} is unknown: choose one of {known}')
    plan = DatasetPlan((profile,), trials=trials, seconds=seconds)
    # By the name alone: profiles that are added later do not move the seeds.
    return plan_trials(plan, len(DATASETS) + crc32(profile.encode()) % 10_000, seed, preset)


def plan_trials(plan: DatasetPlan, family: int, seed: int, preset: str) -> list[TrialSpec]:
    """Return the trials of a plan.

    Args:
        plan: Content of the data set.
        family: Keeps the trial seeds of different data sets apart.
        seed: Seed of the data set.
        preset: Difficulty preset of the sensors.

    Raises:
        SimulationError: A number is out of range.
    """
    if not 1 <= plan.trials <= SEEDS_PER_DATASET:
        raise SimulationError(f'{plan.trials} trials: 1 to {SEEDS_PER_DATASET} are possible')
    if not 0 <= seed < DATASET_SEEDS:
        raise SimulationError(f'seed {seed}: 0 to {DATASET_SEEDS - 1} are possible')
    first_device = FIRST_SEED + SEEDS_PER_DATASET * seed
    first_trial = FIRST_SEED * (1 + family) + SEEDS_PER_DATASET * seed
    by_device = plan.split_by == 'device'
    groups = split_groups(plan.devices if by_device else plan.trials, first_trial)
    return [
        TrialSpec(
            name=f'trial_{index:03d}',
            profile=plan.profiles[index // plan.devices % len(plan.profiles)],
            seconds=plan.seconds,
            device_seed=first_device + index % plan.devices,
            trial_seed=first_trial + index,
            preset=preset,
            split=groups[index % plan.devices if by_device else index],
        )
        for index in range(plan.trials)
    ]
