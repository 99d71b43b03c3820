# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Plans of simulated trials: for training and evaluation, and the named data sets.

Device and trial seeds of training and evaluation never overlap; those of data sets begin beyond
both. Data sets are split into training and test 8:2, by whole trials or whole sensors, never by
sample. A digest of the simulator's source distinguishes data sets of different simulators.
"""

from __future__ import annotations

import functools
import hashlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final
from zlib import crc32

import numpy as np

from mixtac_core.recordings import dataset
from mixtac_sim import SimulationError
from mixtac_sim.grids import stream
from mixtac_sim.world.effects import preset as named_preset
from mixtac_sim.world.profiles import DEMO_MINIMUM_S, PROFILES
from mixtac_sim.world.trial import Trial, simulate_trial

TRAINING_PROFILES = (
    *('dynamic', 'impact', 'press', 'oscillation'),
    *('impact', 'dynamic', 'static', 'demo'),
)
"""Taken in turn. Impacts come twice: they are short, and a net that saw none misses them."""
EVALUATION_PROFILES = ('press', 'oscillation', 'impact', 'dynamic', 'static', 'demo')
TRAINING_PRESET: Final = 'easy'
"""Default preset of simulated training and evaluation trials."""
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
        device_seed: Seed of the sensor: beads, gel, lamp, pixels.
        trial_seed: Seed of the trial: contact point, speeds, noise, clocks.
        profile: Force profile of `mixtac_sim.world.profiles`.
        seconds: Length.
        preset: Difficulty preset of the sensor (`mixtac_sim.world.effects`).
        session: Seed of the day that several trials share; None for a day of its own.
    """

    device_seed: int
    trial_seed: int
    profile: str
    seconds: float
    preset: str = TRAINING_PRESET
    session: int | None = None

    @property
    def name(self) -> str:
        """File name for data of the trial."""
        seeds = f'd{self.device_seed}_t{self.trial_seed}'
        session = '' if self.session is None else f'_s{self.session}'
        return f'{self.profile}_{seeds}_{self.seconds:g}s_{self.preset}{session}'


def _spec(
    device: int, trial: int, profile: str, seconds: float, preset: str = TRAINING_PRESET
) -> TrialSpec:
    seconds = max(seconds, DEMO_MINIMUM_S) if profile == 'demo' else seconds
    return TrialSpec(device, trial, profile, seconds, preset)


def training_plan(
    trials: int,
    gels: int,
    seconds: float,
    seed: int,
    presets: tuple[str, ...] = (TRAINING_PRESET,),
    profiles: tuple[str, ...] = TRAINING_PROFILES,
) -> list[TrialSpec]:
    """Return `trials` trials over `gels` sensors, profiles in turn.

    Args:
        trials: Number of trials.
        gels: Number of different sensors.
        seconds: Length of a trial.
        seed: Shifts all seeds: another seed gives other sensors and other days.
        presets: Difficulty presets of the sensors, in turn.
        profiles: Force profiles, in turn.
    """
    first = TRAINING_DEVICES + 1000 * (seed % 100)
    return [
        _spec(
            first + index % gels,
            TRAINING_TRIALS + 1000 * (seed % 100) + index,
            profiles[(index + (index // gels if gels > 1 else 0)) % len(profiles)],
            seconds,
            presets[index % gels % len(presets)],
        )
        for index in range(trials)
    ]


SESSION_TESTED = 0.2
"""Part of the trials of a session that is tested on: 8:2 by trial, as in the paper."""


def session_plan(
    trials: dict[str, tuple[int, float]], seed: int, preset: str = TRAINING_PRESET
) -> tuple[list[TrialSpec], list[TrialSpec]]:
    """Return the trials of one session of one sensor, split at random: to train on, to test on.

    Args:
        trials: Number and length [s] of the trials by profile; each is split by itself, and one
            trial at least is tested on.
        seed: Another seed gives another sensor, another day and another split.
        preset: Difficulty preset of the sensor.
    """
    first = 1000 * (seed % 100)
    rng = np.random.default_rng(seed)
    trained: list[TrialSpec] = []
    tested: list[TrialSpec] = []
    for column, (profile, (count, seconds)) in enumerate(trials.items()):
        # Beyond the seeds of `training_plan`, which begins at the same one.
        number = TRAINING_TRIALS + first + 500 + 100 * column
        specs = [
            replace(
                _spec(TRAINING_DEVICES + first, number + k, profile, seconds, preset),
                session=TRAINING_TRIALS + first,
            )
            for k in range(count)
        ]
        order = rng.permutation(count)
        held = max(round(SESSION_TESTED * count), 1)
        tested += [specs[k] for k in sorted(order[:held])]
        trained += [specs[k] for k in sorted(order[held:])]
    return trained, tested


def evaluation_plan(
    devices: list[int],
    seconds: float,
    seed: int,
    preset: str = TRAINING_PRESET,
    profiles: tuple[str, ...] = EVALUATION_PROFILES,
    first: int = 0,
) -> list[TrialSpec]:
    """Return one trial per profile and sensor with trial seeds that training never uses.

    Args:
        devices: Device seeds.
        seconds: Length of a trial.
        seed: Another seed gives other days.
        preset: Difficulty preset of the sensors.
        profiles: Force profiles.
        first: Number of the first trial of a sensor, below 100; equal numbers are one day.
    """
    return [
        _spec(device, UNSEEN + 10_000 * seed + 100 * row + column, profile, seconds, preset)
        for row, device in enumerate(devices)
        for column, profile in enumerate(profiles, first)
    ]


def unseen_devices(count: int, seed: int) -> list[int]:
    """Return device seeds that training never uses."""
    return [UNSEEN + 1000 * seed + index for index in range(count)]


def simulate(spec: TrialSpec) -> Trial:
    """Return the trial that `spec` names, with synchronising impulses and the rest around them."""
    seeds, level = (spec.device_seed, spec.trial_seed), named_preset(spec.preset)
    return simulate_trial(
        *seeds, spec.profile, spec.seconds, sync=True, preset=level, session=spec.session
    )


_MAKES_TRIALS = ('mechanics', 'optics', 'pixels', 'world', 'bags')
"""Folders of the simulator on which trials and their bags depend."""
_ALSO = ('grids.py', 'usb/words.py', 'usb/stream.py', 'world/presets.yaml')
"""Further files on which they depend."""


@functools.cache
def simulator_digest() -> str:
    """Return a short digest of the source that makes trials and their bags [16 hex digits].

    Trials of another digest may differ.
    """
    root = Path(__file__).parents[1]
    files = [root / name for name in _ALSO]
    for folder in _MAKES_TRIALS:
        files += (root / folder).rglob('*.py')
    digest = hashlib.sha256()
    for path in sorted(files):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


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


def describe(
    name: str, seed: int, preset: str, split_by: str, trials: list[dataset.TrialSpec]
) -> dataset.DatasetDescription:
    """Return the description of trials that this simulator is about to make."""
    generator = {'package': 'mixtac_sim', 'digest': simulator_digest()}
    return dataset.DatasetDescription(name, seed, preset, split_by, tuple(trials), generator)


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


def plan_dataset(name: str, seed: int = 0, preset: str = DATASET_PRESET) -> list[dataset.TrialSpec]:
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
) -> list[dataset.TrialSpec]:
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


def plan_trials(plan: DatasetPlan, family: int, seed: int, preset: str) -> list[dataset.TrialSpec]:
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
        dataset.TrialSpec(
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
