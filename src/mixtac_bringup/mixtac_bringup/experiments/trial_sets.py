# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Which trials models are trained on and judged on: simulated ones, or a user's bags."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

from mixtac_bringup.errors import BagError
from mixtac_bringup.experiments.sizes import DYNAMIC, HOLD, IMPACT, PRESET, STATIC, TRAINED
from mixtac_fger.train.run_config import DataConfig, SimulatedData
from mixtac_fger.trial_plan import TrialSpec, training_plan
from mixtac_fger.trials.bag_source import BagSource, bag_sources
from mixtac_fger.trials.simulated_source import SimulatedSource

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from mixtac_bringup.experiments.sizes import Sizes
    from mixtac_fger.trials.trial_source import TrialSource

PROFILES = (DYNAMIC, STATIC, HOLD, IMPACT)
FIRST_DATA_SEED = 40
"""Data seeds of `mixtac_fger.trial_plan`, apart from those of shipped models."""
FIRST_TEST = 830_000
"""First trial seed of the tests; training uses 100,000 to 200,000."""
SHARE_TESTED = 5
"""One bag in so many is judged on: 8:2 by trial, as in the paper."""


class TrialSets(Protocol):
    """Where training and test trials come from; must survive being sent to another process."""

    @property
    def simulated(self) -> bool:
        """Whether the trials are simulated."""

    def training(self, seed: int) -> DataConfig:
        """Return what the models of a seed are trained on."""

    def tests(self, seed: int, profile: str) -> Sequence[TrialSource]:
        """Return trials of a profile that no model of the seed was trained on.

        Raises:
            MixtacError: There are none.
        """

    def describe(self, profile: str) -> str:
        """Return the data set in words."""


@dataclass(frozen=True, slots=True)
class SimulatedTrials:
    """One simulated sensor per seed.

    Attributes:
        sizes: How many and how long.
    """

    sizes: Sizes

    @property
    def simulated(self) -> bool:
        """Yes."""
        return True

    def training(self, seed: int) -> DataConfig:
        """Return trials of the seed's sensor."""
        sizes = self.sizes
        data = SimulatedData(
            PRESET, 1, sizes.trials, sizes.seconds, TRAINED, FIRST_DATA_SEED + seed
        )
        return DataConfig(simulated=data, checked=0.0)

    def tests(self, seed: int, profile: str) -> Sequence[TrialSource]:
        """Return other days of the same sensor."""
        count, seconds = self.sizes.tests[profile]
        device = training_plan(1, 1, 1.0, FIRST_DATA_SEED + seed, PRESET)[0].device_seed
        first = FIRST_TEST + 1000 * seed + 100 * PROFILES.index(profile)
        specs = [TrialSpec(device, first + k, profile, seconds, PRESET) for k in range(count)]
        return [SimulatedSource(spec) for spec in specs]

    def describe(self, profile: str) -> str:
        """Return sizes, preset and seeds."""
        sizes = self.sizes
        count, seconds = sizes.tests[profile]
        trained = ', '.join(dict.fromkeys(TRAINED[: sizes.trials]))
        return (
            f'virtual sensor, preset {PRESET}; per seed one sensor, trained on {sizes.trials}'
            f' trials of {sizes.seconds:g} s ({trained}; data seeds from'
            f' {FIRST_DATA_SEED}), judged on {count} {profile} trials of {seconds:g} s of other'
            f' days (trial seeds from {FIRST_TEST})'
        )


@dataclass(frozen=True, slots=True)
class BagTrials:
    """A user's bags: one folder per profile, as `mixtac simulate --dataset NAME` makes them.

    Trials that a `dataset.yaml` gives to a split stay there; of the others every fifth is
    judged on and the rest is trained on.

    Attributes:
        folder: Holds folders named `dynamic`, `static`, `long_term` and `impact`.
    """

    folder: Path

    @property
    def simulated(self) -> bool:
        """Whether all bags say that they are."""
        return all(is_simulated(bag) for name in PROFILES for bag in self._bags(name))

    def training(self, seed: int) -> DataConfig:
        """Return the training bags of all profiles, for every seed the same.

        Raises:
            BagError: There are none.
        """
        del seed
        bags = [bag for name in PROFILES for bag in self._split(name)[0]]
        if not bags:
            raise BagError(f'{self.folder} holds no bags to train on: {_remedy()}')
        return DataConfig(bags=tuple(str(bag.path) for bag in bags), checked=0.0)

    def tests(self, seed: int, profile: str) -> Sequence[TrialSource]:
        """Return the bags of a profile that were held out.

        Raises:
            BagError: There are none.
        """
        del seed
        held = self._split(profile)[1]
        if not held:
            raise BagError(f'{self.folder / profile} holds no bags to judge on: {_remedy()}')
        return held

    def describe(self, profile: str) -> str:
        """Return the folder and how many bags there are."""
        trained, held = self._split(profile)
        total = sum(len(self._split(name)[0]) for name in PROFILES)
        kind = 'simulated bags' if self.simulated else 'recorded bags'
        return (
            f'{kind} in {self.folder.name}: {total} trained on, of these {len(trained)} {profile};'
            f' {len(held)} {profile} bags judged on, split by trial'
        )

    def _bags(self, profile: str) -> list[BagSource]:
        folder = self.folder / profile
        return bag_sources(folder) if folder.is_dir() else []

    def _split(self, profile: str) -> tuple[list[BagSource], list[BagSource]]:
        trained: list[BagSource] = []
        held: list[BagSource] = []
        for index, bag in enumerate(self._bags(profile)):
            by_order = 'val' if index % SHARE_TESTED == SHARE_TESTED - 1 else 'train'
            split = bag.origin.get('split', by_order)
            fields = dict(bag.described) | {'profile': profile}
            named = replace(bag, described=tuple(sorted(fields.items())))
            (trained if split == 'train' else held).append(named)
        return trained, held


def trial_sets(sizes: Sizes, bags: Path | None) -> SimulatedTrials | BagTrials:
    """Return simulated trials, or those of a folder of bags."""
    return SimulatedTrials(sizes) if bags is None else BagTrials(bags)


def is_simulated(bag: BagSource) -> bool:
    """Return whether a bag, or what describes it, says that it was simulated."""
    return bool(bag.origin.get('simulated')) or 'trial_seed' in bag.origin


def _remedy() -> str:
    return (
        f'record at least five trials into each of the folders {", ".join(PROFILES)}, with the'
        ' reference sensor, and align them'
    )
