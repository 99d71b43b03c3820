# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Which simulated trials an estimator is trained on and evaluated with, and their simulation.

Device and trial seeds of training and evaluation never overlap; those of data sets
(`mixtac_sim.world.datasets`) begin beyond both.
"""

from __future__ import annotations

import functools
import hashlib
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
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
        profile: Force profile of `mixtac_sim.world.profiles`.
        seconds: Length.
        preset: How hard the simulated sensor is (`mixtac_sim.world.effects`).
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


_APART = {'usb', 'arm', 'grasp', 'datasets'}
"""Parts of the simulator that no trial is made with."""
_NODES = ('_node', '_parameters', '_cli')
"""Ends of the names of modules that only run it."""


def simulate(spec: TrialSpec) -> Trial:
    """Return the trial that `spec` names, with synchronising impulses and the rest around them."""
    from mixtac_sim.world.effects import preset
    from mixtac_sim.world.trial import simulate_trial

    chosen = preset(spec.preset)
    if spec.without:
        chosen = chosen.without(spec.without)
    seeds = (spec.device_seed, spec.trial_seed)
    return simulate_trial(*seeds, spec.profile, spec.seconds, sync=True, preset=chosen)


def stiffness(spec: TrialSpec, *, known_sensor: bool = False) -> float:
    """Return how stiff the gel of a trial is over what a model can know before it.

    Args:
        spec: The trial.
        known_sensor: The sensor's usual stiffness is known, and only that of the day is not.

    Returns:
        Modulus of sensor and day over the usual modulus of all sensors, or of this one.
    """
    from mixtac_sim.world.device import draw_conditions, draw_device
    from mixtac_sim.world.effects import preset

    chosen = preset(spec.preset)
    day = draw_conditions(spec.trial_seed, chosen).stiffness
    if known_sensor:
        return day
    alike = replace(chosen, gel=replace(chosen.gel, modulus_log_sd=0.0))
    usual, own = (draw_device(spec.device_seed, each) for each in (alike, chosen))
    return day * own.layer.modulus_kpa / usual.layer.modulus_kpa


@functools.cache
def simulator_digest() -> str:
    """Return a short digest of the source that makes trials: samples of another one are stale."""
    import mixtac_sim

    root = Path(str(mixtac_sim.__file__)).parent
    digest = hashlib.sha256()
    for path in sorted(root.rglob('*.py')):
        apart = _APART.intersection(path.relative_to(root).parts)
        if not apart and not path.stem.endswith(_NODES):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:12]
