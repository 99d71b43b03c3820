# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The file `dataset.yaml` beside the bags of a data set, and the trials that it lists."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import yaml

from mixtac_core.node.files import FileError, locked, read_data, structure, write_text

SPLITS: Final = ('train', 'test')


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


FILE_NAME: Final = 'dataset.yaml'
SCHEMA: Final = 'mixtac-dataset'
"""Schema of the file of a simulated data set."""
RECORDINGS_SCHEMA: Final = 'mixtac-recordings'
"""Schema of the file of recordings."""
SCHEMA_VERSION: Final = 1
"""Version of both."""


@dataclass(frozen=True, slots=True)
class DatasetDescription:
    """Description of a data set.

    Attributes:
        name: Name of the data set or of its profile.
        seed: Seed of the plan of its trials.
        preset: Strength of the simulated effects.
        split_by: `trial` or `device`.
        trials: Its trials; each has a bag of its name beside the file.
        generator: Package and digest of the simulator.
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
        document = {**_head(SCHEMA), 'simulated': True, **fields, 'trials': trials}
        write_text(folder / FILE_NAME, yaml.safe_dump(document, sort_keys=False))

    @staticmethod
    def read(folder: Path) -> DatasetDescription:
        """Read the file of a data set.

        Args:
            folder: Folder of the data set.

        Raises:
            FileError: It is missing or damaged, or of another schema.
        """
        path = folder / FILE_NAME
        document = _read(path, SCHEMA)
        for key in (*_head(SCHEMA), 'simulated'):
            document.pop(key, None)
        return structure(document, DatasetDescription, str(path))


def _head(schema: str) -> dict[str, Any]:
    return {'schema': schema, 'schema_version': SCHEMA_VERSION}


def _read(path: Path, schema: str = '') -> dict[str, Any]:
    """Return the content of a `dataset.yaml` with a list of trials; of any schema if none given."""
    found = read_data(path)
    document = dict(found) if isinstance(found, dict) else {}
    if schema and document | _head(schema) != document:
        raise FileError(
            f'{path} is not of schema {schema}, version {SCHEMA_VERSION}',
            remedy='use another folder, or the release that wrote it',
        )
    trials = document.get('trials')
    if not isinstance(trials, list) or not all(isinstance(t, dict) and 'name' in t for t in trials):
        raise FileError(f'{path} has no list of trials, each with its name', remedy='correct it')
    return document


def add_recording(bag: Path, figures: Mapping[str, Any], *, profile: str, split: str) -> Path:
    """Add a recording to `dataset.yaml` in the parent folder of its bag, and return the file.

    Args:
        bag: Folder of the bag.
        figures: Length and losses of the recording.
        profile: Kind of motion, for example `static`; empty if unknown.
        split: `train`, `test`, or empty.

    Raises:
        FileError: The existing file describes something else or is damaged, or cannot be written.
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
    """Return the content of a `dataset.yaml` of recordings; without trials if it is missing.

    Raises:
        FileError: It describes something else, or is damaged.
    """
    if not path.exists():
        return {**_head(RECORDINGS_SCHEMA), 'trials': []}
    return _read(path, RECORDINGS_SCHEMA)


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
        FileError: The file cannot be read, or has no list of trials.
    """
    path = bag.parent / FILE_NAME
    trials = _read(path)['trials'] if path.exists() else []
    return next((dict(trial) for trial in trials if trial['name'] == bag.name), {})
