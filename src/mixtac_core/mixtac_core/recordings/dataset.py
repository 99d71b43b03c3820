# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The file `dataset.yaml` beside the bags of a data set, and the trials that it lists."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import yaml

from mixtac_core.events.errors import MixtacError
from mixtac_core.node.files import FileError, locked, read_data, structure, write_text

SPLITS: Final = ('train', 'test')


class DatasetError(MixtacError):
    """An invalid or unreadable description of a data set or of a trial."""


@dataclass(frozen=True, slots=True)
class TrialSpec:
    """One simulated trial.

    Attributes:
        name: Name of its bag.
        profile: Force profile, as in `mixtac_sim.world.profiles.make_profile`.
        seconds: Length [s].
        device_seed: Seed of the sensor: beads, gel, mesh, lens, lamp, pixels.
        trial_seed: Seed of the day: contact point, forces, noise, clocks.
        preset: Strength of the simulated effects.
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
        """Check the name and the split.

        Raises:
            DatasetError: The name cannot be that of a bag, or the split is unknown.
        """
        if not self.name.replace('_', '').replace('-', '').isalnum():
            raise DatasetError(
                f'trial name {self.name!r} is not allowed', remedy='use letters, digits, _ and -'
            )
        if self.split not in SPLITS:
            raise DatasetError(f'unknown split {self.split!r}', remedy=f'use one of {SPLITS}')


FILE_NAME: Final = 'dataset.yaml'
SCHEMA: Final = 'mixtac-dataset'
SCHEMA_VERSION: Final = 1
_NOT_FIELDS: Final = {'schema', 'schema_version', 'simulated'}


@dataclass(frozen=True, slots=True)
class DatasetDescription:
    """Description of a data set.

    Attributes:
        name: Name of the data set or of its profile.
        seed: Seed of the plan of its trials.
        preset: Strength of the simulated effects.
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

    def same_trials_as(self, other: DatasetDescription) -> bool:
        """Return whether the bags of both would be the same, byte by byte."""
        return self.trials == other.trials and self.generator == other.generator

    def split(self, name: str) -> list[TrialSpec]:
        """Return the trials of `train` or `test`."""
        return [trial for trial in self.trials if trial.split == name]

    def write(self, folder: Path) -> None:
        """Write the file, whole or not at all.

        Args:
            folder: Folder of the data set.

        Raises:
            FileError: It cannot be written.
        """
        fields = asdict(self)
        # The trials last: they fill most of the file.
        trials = list(fields.pop('trials'))
        document = {'schema': SCHEMA, 'schema_version': SCHEMA_VERSION, 'simulated': True}
        document |= {**fields, 'trials': trials}
        write_text(folder / FILE_NAME, yaml.safe_dump(document, sort_keys=False))

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
            document = read_data(path)
            if not isinstance(document, dict) or document.get('schema') != SCHEMA:
                raise DatasetError(f'{path} does not describe a Mixtac data set')
            version = document.get('schema_version')
            if version != SCHEMA_VERSION:
                raise DatasetError(
                    f'{path} has schema version {version}, not {SCHEMA_VERSION}',
                    remedy='use the matching release, or generate the data set again',
                )
            known = {key: document[key] for key in document if key not in _NOT_FIELDS}
            return structure(known, DatasetDescription, str(path))
        except FileError as error:
            raise DatasetError(str(error)) from error


RECORDINGS_SCHEMA = 'mixtac-recordings'
RECORDINGS_VERSION = 1


def add_recording(bag: Path, figures: Mapping[str, Any], *, profile: str, split: str) -> Path:
    """Add a recording to `dataset.yaml` in the parent folder of its bag, and return the file.

    Args:
        bag: Folder of the bag.
        figures: Length and losses of the recording.
        profile: Kind of motion, for example `static`; empty if unknown.
        split: `train`, `test`, or empty.

    Raises:
        DatasetError: The existing file describes something else or is damaged.
        FileError: The file cannot be written.
    """
    path = bag.absolute().parent / FILE_NAME
    # Another recording may end at the same moment, beside the same file or a link to it.
    with locked(path.resolve().parent):
        document = read_recordings(path)
        others = [each for each in document['trials'] if each['name'] != bag.name]
        entry = {'name': bag.name, 'profile': profile, 'split': split, **figures}
        document['trials'] = [*others, entry]
        write_text(path, yaml.safe_dump(document, sort_keys=False))
    return path


def read_recordings(path: Path) -> dict[str, Any]:
    """Return the content of a `dataset.yaml` of recordings, one without trials if there is none.

    Raises:
        DatasetError: It describes something else.
        FileError: It is damaged.
    """
    if not path.exists():
        return {'schema': RECORDINGS_SCHEMA, 'schema_version': RECORDINGS_VERSION, 'trials': []}
    document = read_data(path)
    known = isinstance(document, dict) and document.get('schema') == RECORDINGS_SCHEMA
    if not known or document.get('schema_version') != RECORDINGS_VERSION:
        raise DatasetError(
            f'{path} does not describe recordings (schema {RECORDINGS_SCHEMA}, version '
            f'{RECORDINGS_VERSION})',
            remedy='record to another folder',
        )
    trials = document.get('trials')
    if not isinstance(trials, list) or not all(isinstance(t, dict) and 'name' in t for t in trials):
        raise DatasetError(
            f'{path} has no list of trials, each with its name', remedy='record to another folder'
        )
    return dict(document)


def folder_facts(bag: Path) -> dict[str, Any]:
    """Return profile and split of a bag that nothing describes, by the folders it lies in.

    The profile is the name of its folder; a folder named `train` or `test` is the split, and the
    one above it the profile then.
    """
    above = [each.name for each in bag.absolute().parents][:2]
    split = next((name for name in above if name in SPLITS), '')
    profile = next((name for name in above if name and name not in SPLITS), '')
    facts = {'profile': profile, 'split': split}
    return {name: value for name, value in facts.items() if value}


def described_trial(bag: Path) -> dict[str, Any]:
    """Return what the `dataset.yaml` beside a bag says of it; empty without a file or an entry.

    Raises:
        DatasetError: The file cannot be read.
    """
    path = bag.parent / FILE_NAME
    if not path.exists():
        return {}
    try:
        trials = {each['name']: dict(each) for each in read_data(path)['trials']}
    except (FileError, KeyError, TypeError, ValueError) as error:
        raise DatasetError(f'{path} cannot be read ({error})', remedy='correct the file') from error
    return trials.get(bag.name, {})
