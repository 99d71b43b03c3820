# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Trials and prepared samples on disk, keyed by their content and by how they were prepared."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import joblib
import numpy as np
from numpy.typing import NDArray

from mixtac_core.events.arrays import Events
from mixtac_core.events.errors import MixtacError
from mixtac_core.node.files import FileError, new_folder
from mixtac_learning.trials.trial import (
    DatasetError,
    DerivedSource,
    ForceLabel,
    TrialArrays,
    TrialSource,
)

_FRAMES = ('frames', 'exposure_start_us', 'exposure_end_us', 'arrival_us')
_EVENTS = ('events_t', 'events_x', 'events_y', 'events_polarity')
_LABELS = ('truth', 'reference')
_FACTS = 'trial.json'


@dataclass(frozen=True)
class CachedSource(DerivedSource):
    """A source whose trial is kept on disk once it was loaded.

    Attributes:
        folder: Parent of the trial's own folder.
    """

    folder: Path

    def load(self) -> TrialArrays:
        """Return the trial, mapped from disk.

        Raises:
            MixtacError: It cannot be used, or the disk is full.
        """
        digest = hashlib.blake2b(self.content_key().encode(), digest_size=8).hexdigest()
        path = self.folder / f'{self.name}-{digest}'
        if not path.exists():
            trial = self.source.load()
            arrays = {name: getattr(trial, name) for name in _FRAMES}
            arrays |= {name: getattr(trial.events, name[len('events_') :]) for name in _EVENTS}
            for name in _LABELS:
                label: ForceLabel | None = getattr(trial, name)
                if label is not None:
                    arrays[name] = np.stack([label.t_us, label.force])
            write_arrays(path, arrays, {'origin': trial.origin}, _FACTS)
        kept, facts = read_arrays(path, _FACTS, [*_FRAMES, *_EVENTS])
        fields: dict[str, Any] = {name: kept[name] for name in _FRAMES}
        for name in _LABELS:
            fields[name] = ForceLabel(*np.array(kept[name])) if name in kept else None
        events = Events(*(np.array(kept[name]) for name in _EVENTS))
        return TrialArrays(events=events, **fields, origin=facts['origin'])


def write_arrays(
    path: Path, arrays: Mapping[str, NDArray[np.generic]], facts: object, facts_file: str
) -> None:
    """Write a folder of arrays that can be mapped, whole or not at all.

    Processes may write the same folder at the same time: the first one's stays.

    Args:
        path: Folder to write.
        arrays: By name; one file each.
        facts: What else belongs to them, JSON-ready.
        facts_file: File of the facts in the folder.

    Raises:
        FileError: It cannot be written.
    """
    try:
        with new_folder(path) as folder:
            folder.mkdir()
            for name, array in arrays.items():
                np.save(folder / f'{name}.npy', array, allow_pickle=False)
            (folder / facts_file).write_text(json.dumps(facts), encoding='utf-8')
    except FileError:
        if not path.is_dir():
            raise


def read_arrays(
    path: Path, facts_file: str, needed: Iterable[str]
) -> tuple[dict[str, NDArray[Any]], Any]:
    """Map the arrays of a folder, and read its facts.

    Args:
        path: Folder.
        facts_file: File of the facts in it.
        needed: Names of the arrays that it must have.

    Raises:
        DatasetError: The folder is missing or damaged.
    """
    try:
        facts = json.loads((path / facts_file).read_text(encoding='utf-8'))
        names = {*needed, *(file.stem for file in path.glob('*.npy'))}
        return {name: np.load(path / f'{name}.npy', mmap_mode='r') for name in names}, facts
    except (OSError, EOFError, ValueError) as error:
        raise DatasetError(
            f'{path} cannot be read ({error})', remedy='remove it; it is then prepared again'
        ) from error


class Recipe(Protocol):
    """Recipe of a network's samples; must be picklable, to be sent to other processes."""

    @property
    def suffix(self) -> str:
        """Suffix of the files."""

    def fingerprint(self) -> dict[str, Any]:
        """Return everything that changes what a sample holds, as JSON-ready values."""

    def write(self, trial: TrialArrays, path: Path) -> None:
        """Prepare a trial and write it, whole or not at all.

        Raises:
            DatasetError: The trial cannot be used.
        """


@dataclass(frozen=True, slots=True)
class Prepared:
    """Samples on disk, and the trials that could not be used.

    Attributes:
        paths: Files, in the order of their sources.
        skipped: Why a trial was left out, by its name.
        kept: Which of the sources gave a sample, by index.
    """

    paths: list[Path]
    skipped: dict[str, str]
    kept: list[int]


def sample_path(source: TrialSource, recipe: Recipe, folder: Path) -> Path:
    """Return the file of a source's sample: its name and a digest of content and recipe."""
    described = json.dumps([source.content_key(), recipe.fingerprint()], sort_keys=True)
    digest = hashlib.blake2b(described.encode(), digest_size=8).hexdigest()
    return folder / f'{source.name}-{digest}{recipe.suffix}'


def prepare(
    sources: Sequence[TrialSource],
    recipe: Recipe,
    folder: Path,
    jobs: int = 1,
    on_progress: Callable[[int], None] = lambda _done: None,
) -> Prepared:
    """Make sure that the samples of all sources are on disk.

    One trial per process is in memory at a time. A trial that cannot be used is left out and
    reported; the others are used.

    Args:
        sources: Trials.
        recipe: Recipe of the samples.
        folder: Folder of the samples.
        jobs: Processes.
        on_progress: Called with the number of trials done.

    Raises:
        DatasetError: No trial can be used.
    """
    folder.mkdir(parents=True, exist_ok=True)
    paths, skipped, kept = [], {}, []
    calls = [joblib.delayed(_prepare_one)(source, recipe, folder) for source in sources]
    results = joblib.Parallel(jobs, return_as='generator', batch_size=1)(calls)
    for index, (path, reason) in enumerate(results):
        if path is None:
            skipped[sources[index].name] = reason
        else:
            paths.append(path)
            kept.append(index)
        on_progress(index + 1)
    if not paths:
        first = next(iter(skipped.values()), 'there are none')
        raise DatasetError(f'none of {len(sources)} trials can be used: {first}')
    return Prepared(paths, skipped, kept)


def _prepare_one(source: TrialSource, recipe: Recipe, folder: Path) -> tuple[Path | None, str]:
    try:
        path = sample_path(source, recipe, folder)
        if not path.exists():
            recipe.write(source.load(), path)
    except MixtacError as error:
        return None, str(error)
    return path, ''
