# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The file `dataset.yaml` beside the bags of a data set, and the trials that it lists."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import yaml

from mixtac_events.errors import MixtacError

if TYPE_CHECKING:
    from pathlib import Path


SPLITS: Final = ('train', 'test')


class DatasetError(MixtacError):
    """A description of a data set or of a trial that cannot be read or is not allowed."""


@dataclass(frozen=True, slots=True)
class TrialSpec:
    """One simulated trial.

    Attributes:
        name: Name of its bag.
        profile: Force profile, as in `mixtac_sim.world.profiles.make_profile`.
        seconds: Length [s].
        device_seed: Which sensor: beads, gel, mesh, lens, lamp, pixels.
        trial_seed: Which day: contact point, forces, noise, clocks.
        preset: How hard the effects are.
        split: `train` or `test`.
    """

    name: str
    profile: str
    seconds: float
    device_seed: int
    trial_seed: int
    preset: str
    split: str

    def __post_init__(self) -> None:
        """Refuse what cannot be a bag's name or a split.

        Raises:
            DatasetError: As above.
        """
        if not self.name.replace('_', '').replace('-', '').isalnum():
            raise DatasetError(
                f'trial name {self.name!r} would not be a folder: use letters, digits, _ and -'
            )
        if self.split not in SPLITS:
            raise DatasetError(f'split {self.split!r} is unknown: use one of {SPLITS}')

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as values for YAML or JSON."""
        return asdict(self)

    @staticmethod
    def from_dict(fields: dict[str, Any]) -> TrialSpec:
        """Return the trial of such values.

        Raises:
            DatasetError: A field is missing, unknown or not allowed.
        """
        try:
            spec = TrialSpec(**fields)
        except TypeError as error:
            raise DatasetError(f'a trial cannot be read from {fields}: {error}') from error
        return spec


FILE_NAME: Final = 'dataset.yaml'
SCHEMA: Final = 'mixtac-dataset'
SCHEMA_VERSION: Final = 1
_SETTINGS: Final = ('name', 'seed', 'preset', 'split_by', 'complete', 'generator')


@dataclass(frozen=True, slots=True)
class DatasetDescription:
    """What a data set is and what it is made of.

    Attributes:
        name: Name of the data set or of its profile.
        seed: Seed that its trials were planned with.
        preset: How hard the effects are.
        split_by: `trial` or `device`.
        trials: Its trials; each has a bag of its name beside the file.
        generator: Package, version and digest of the simulator.
        complete: Whether all bags have been written.
    """

    name: str
    seed: int
    preset: str
    split_by: str
    trials: tuple[TrialSpec, ...]
    generator: dict[str, str]
    complete: bool = False

    def completed(self) -> DatasetDescription:
        """Return the same with all bags written."""
        return replace(self, complete=True)

    def same_trials_as(self, other: DatasetDescription) -> bool:
        """Return whether the bags of both would be the same, byte by byte."""
        return self.trials == other.trials and self.generator == other.generator

    def split(self, name: str) -> list[TrialSpec]:
        """Return the trials of `train` or `test`."""
        return [trial for trial in self.trials if trial.split == name]

    def write(self, folder: Path) -> None:
        """Write the file, in one step: a reader sees the old file or the new one.

        Args:
            folder: Folder of the data set.
        """
        document: dict[str, Any] = {'schema': SCHEMA, 'schema_version': SCHEMA_VERSION}
        document['simulated'] = True
        document |= {key: getattr(self, key) for key in _SETTINGS}
        document['trials'] = [trial.to_dict() for trial in self.trials]
        partial = folder / f'.{FILE_NAME}.partial'
        partial.write_text(yaml.safe_dump(document, sort_keys=False), encoding='utf8')
        partial.replace(folder / FILE_NAME)

    @staticmethod
    def read(folder: Path) -> DatasetDescription:
        """Read the file of a data set.

        Args:
            folder: Folder of the data set.

        Raises:
            DatasetError: It is missing, damaged, or of another schema.
        """
        path = folder / FILE_NAME
        try:
            document = yaml.safe_load(path.read_text(encoding='utf8'))
        except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
            raise DatasetError(f'{path} cannot be read ({error}): name a data set') from error
        if not isinstance(document, dict) or document.get('schema') != SCHEMA:
            raise DatasetError(f'{path} does not describe a Mixtac data set')
        if document.get('schema_version') != SCHEMA_VERSION:
            raise DatasetError(
                f'{path} has schema version {document.get("schema_version")}, this is for '
                f'{SCHEMA_VERSION}: use the matching release, or generate it anew'
            )
        try:
            trials = tuple(TrialSpec.from_dict(fields) for fields in document['trials'])
            return DatasetDescription(trials=trials, **{key: document[key] for key in _SETTINGS})
        except (KeyError, TypeError) as error:
            raise DatasetError(f'{path} lacks {error}: generate it anew') from error
