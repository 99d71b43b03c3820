# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Plans of the simulated trials for training and evaluation, and their simulation.

Device and trial seeds of training and evaluation never overlap; those of data sets
(`mixtac_sim.world.datasets`) begin beyond both.
"""

from __future__ import annotations

import functools
import hashlib
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mixtac_sim.world.trial import Trial

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
TRAINING_PRESET = 'easy'
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
        without: Effect of the preset that is switched off; empty for none.
        session: Seed of the day that several trials share; None for a day of its own.
    """

    device_seed: int
    trial_seed: int
    profile: str
    seconds: float
    preset: str = TRAINING_PRESET
    without: str = ''
    session: int | None = None

    @property
    def name(self) -> str:
        """File name for data of the trial."""
        seeds = f'd{self.device_seed}_t{self.trial_seed}'
        kind = self.preset if not self.without else f'{self.preset}-{self.without}'
        kind += '' if self.session is None else f'_s{self.session}'
        return f'{self.profile}_{seeds}_{self.seconds:g}s_{kind}'


SHORTEST_S = {'demo': 10.0}
"""Shortest length of profiles that need some time [s]."""


def _spec(
    device: int, trial: int, profile: str, seconds: float, preset: str = TRAINING_PRESET
) -> TrialSpec:
    return TrialSpec(device, trial, profile, max(seconds, SHORTEST_S.get(profile, 0.0)), preset)


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
        # Beyond those of `training_plan`, which begins at the same seed.
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
    profiles: tuple[str, ...] = EVALUATION_PROFILES,
    preset: str = TRAINING_PRESET,
) -> list[TrialSpec]:
    """Return one trial per profile and sensor with trial seeds that training never uses."""
    return [
        _spec(device, UNSEEN + 10_000 * seed + 100 * row + column, profile, seconds, preset)
        for row, device in enumerate(devices)
        for column, profile in enumerate(profiles)
    ]


def calibration_plan(
    devices: list[int], seconds: float, seed: int, preset: str = TRAINING_PRESET
) -> list[TrialSpec]:
    """Return one more press per sensor, to calibrate it with."""
    return [
        _spec(device, UNSEEN + 10_000 * seed + 100 * row + 99, 'press', seconds, preset)
        for row, device in enumerate(devices)
    ]


def unseen_devices(count: int, seed: int) -> list[int]:
    """Return device seeds that training never uses."""
    return [UNSEEN + 1000 * seed + index for index in range(count)]


def simulate(spec: TrialSpec) -> Trial:
    """Return the trial that `spec` names, with synchronising impulses and the rest around them."""
    from mixtac_sim.world.effects import preset
    from mixtac_sim.world.trial import simulate_trial

    chosen = preset(spec.preset)
    if spec.without:
        chosen = chosen.without(spec.without)
    seeds = (spec.device_seed, spec.trial_seed)
    return simulate_trial(
        *seeds, spec.profile, spec.seconds, sync=True, preset=chosen, session=spec.session
    )


def stiffness(spec: TrialSpec, *, known_sensor: bool = False) -> float:
    """Return the stiffness of the gel in a trial over the stiffness known before it.

    Args:
        spec: The trial.
        known_sensor: The usual stiffness of the sensor is known, but not that of the day.

    Returns:
        Modulus of sensor and day over the usual modulus of all sensors, or of this one.
    """
    from mixtac_sim.world.device import draw_conditions, draw_device
    from mixtac_sim.world.effects import preset

    chosen = preset(spec.preset)
    day = draw_conditions(
        spec.trial_seed if spec.session is None else spec.session, chosen
    ).stiffness
    if known_sensor:
        return day
    alike = replace(chosen, gel=replace(chosen.gel, modulus_log_sd=0.0))
    usual, own = (draw_device(spec.device_seed, each) for each in (alike, chosen))
    return day * own.layer.modulus_kpa / usual.layer.modulus_kpa


_MAKES_TRIALS = ('mechanics', 'optics', 'pixels', 'world', 'bags')
"""Folders of the simulator on which trials and their bags depend."""
_ALSO = ('grids.py', 'random_streams.py', 'usb/words.py', 'usb/stream.py', 'world/presets.yaml')
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
