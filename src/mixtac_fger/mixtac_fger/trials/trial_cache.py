# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Whole trials on disk, mapped instead of read: for trials that several models are judged on."""

from __future__ import annotations

import hashlib
import json
import shutil
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mixtac_events.arrays import Events
from mixtac_fger.dataset import ForceLabel
from mixtac_fger.errors import DatasetError
from mixtac_fger.trials.trial_arrays import TrialArrays

if TYPE_CHECKING:
    from pathlib import Path

    from mixtac_fger.trials.trial_source import TrialSource

_FRAMES = ('frames', 'exposure_start_us', 'exposure_end_us', 'arrival_us')
_EVENTS = ('t', 'x', 'y', 'polarity')
_LABELS = ('truth', 'reference')


@dataclass(frozen=True, slots=True)
class CachedSource:
    """A source whose trial is kept on disk once it was loaded.

    Attributes:
        source: Where the trial comes from.
        folder: Where it is kept, in a folder of its own.
    """

    source: TrialSource
    folder: Path

    @property
    def name(self) -> str:
        """Name of the trial."""
        return self.source.name

    @property
    def origin(self) -> dict[str, Any]:
        """What is known of it."""
        return self.source.origin

    def content_key(self) -> str:
        """Return the key of the source."""
        return self.source.content_key()

    def load(self) -> TrialArrays:
        """Return the trial, mapped from disk.

        Raises:
            MixtacError: It cannot be used, or the disk is full.
        """
        digest = hashlib.blake2b(self.content_key().encode(), digest_size=8).hexdigest()
        path = self.folder / f'{self.name}-{digest}'
        if not path.exists():
            _write(self.source.load(), path)
        return _read(path)


def _write(trial: TrialArrays, path: Path) -> None:
    partial = path.with_name(path.name + '.partial')
    shutil.rmtree(partial, ignore_errors=True)
    try:
        partial.mkdir(parents=True)
        arrays = {name: getattr(trial, name) for name in _FRAMES}
        arrays |= {f'events_{name}': getattr(trial.events, name) for name in _EVENTS}
        for name in _LABELS:
            label: ForceLabel | None = getattr(trial, name)
            if label is not None:
                arrays[name] = np.stack([label.t_us, label.force])
        for name, array in arrays.items():
            np.save(partial / f'{name}.npy', array, allow_pickle=False)
        content = {'origin': trial.origin, 'missing_packets': trial.missing_packets}
        (partial / 'trial.json').write_text(json.dumps(content), encoding='utf-8')
        partial.replace(path)
    except OSError as error:
        raise DatasetError(f'{path} cannot be written ({error}): free some space') from error


def _read(path: Path) -> TrialArrays:
    try:
        content = json.loads((path / 'trial.json').read_text(encoding='utf-8'))
        fields: dict[str, Any] = {
            name: np.load(path / f'{name}.npy', mmap_mode='r') for name in _FRAMES
        }
        events = Events(*(np.load(path / f'events_{name}.npy') for name in _EVENTS))
        for name in _LABELS:
            kept = path / f'{name}.npy'
            fields[name] = ForceLabel(*np.load(kept)) if kept.exists() else None
    except (OSError, ValueError) as error:
        raise DatasetError(f'{path} cannot be read ({error}): remove it') from error
    return TrialArrays(events=events, **fields, **content)
