# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Training samples on disk, and those of FGER-Net: features of a trial, force of each window.

Samples are keyed by the content of their trial and by their recipe.
"""

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

from mixtac_core.events.errors import MixtacError
from mixtac_core.node.files import FileError, new_folder
from mixtac_fger.config import FgerConfig
from mixtac_fger.features import FramePreparation, WindowFeatures, correction_lag, mean_contrast
from mixtac_fger.shear import NEWTONS
from mixtac_learning.trials.trial import (
    DatasetError,
    ForceLabel,
    TrialArrays,
    TrialSource,
    frame_arrivals,
    window_ends,
)


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
        paths: Files of each trial by recipe, in the order of the sources.
        skipped: Why a trial was left out, by its name.
        kept: Which of the sources gave a sample, by index.
    """

    paths: list[list[Path]]
    skipped: dict[str, str]
    kept: list[int]


def sample_path(source: TrialSource, recipe: Recipe, folder: Path) -> Path:
    """Return the file of a source's sample: its name and a digest of content and recipe."""
    described = json.dumps([source.content_key(), recipe.fingerprint()], sort_keys=True)
    digest = hashlib.blake2b(described.encode(), digest_size=8).hexdigest()
    return folder / f'{source.name}-{digest}{recipe.suffix}'


def prepare(
    sources: Sequence[TrialSource],
    recipes: Sequence[Recipe],
    folder: Path,
    jobs: int = 1,
    on_progress: Callable[[int], None] = lambda _done: None,
) -> Prepared:
    """Make sure that the samples of all sources are on disk.

    One trial per process is in memory at a time. A trial that cannot be used is left out and
    reported; the others are used.

    Args:
        sources: Trials.
        recipes: Recipes of the samples; each trial is loaded once for all of them.
        folder: Folder of the samples.
        jobs: Processes.
        on_progress: Called with the number of trials done.

    Raises:
        DatasetError: No trial can be used.
    """
    folder.mkdir(parents=True, exist_ok=True)
    paths, skipped, kept = [], {}, []
    calls = [joblib.delayed(_prepare_one)(source, recipes, folder) for source in sources]
    results = joblib.Parallel(jobs, return_as='generator', batch_size=1)(calls)
    for index, (found, reason) in enumerate(results):
        if found:
            paths.append(found)
            kept.append(index)
        else:
            skipped[sources[index].name] = reason
        on_progress(index + 1)
    if not paths:
        first = next(iter(skipped.values()), 'there are none')
        raise DatasetError(f'none of {len(sources)} trials can be used: {first}')
    return Prepared(paths, skipped, kept)


def _prepare_one(
    source: TrialSource, recipes: Sequence[Recipe], folder: Path
) -> tuple[list[Path], str]:
    try:
        paths = [sample_path(source, recipe, folder) for recipe in recipes]
        missing = [pair for pair in zip(paths, recipes, strict=True) if not pair[0].exists()]
        if missing:
            trial = source.load()
            for path, recipe in missing:
                recipe.write(trial, path)
    except MixtacError as error:
        return [], str(error)
    return paths, ''


CONTACT_N = 0.01
"""Largest true force during the reference frames [N]."""
MEASURED_CONTACT_N = 0.1
"""The same of a measured force, which has noise and a zero of its own [N] (estimate)."""
STORED = np.float16
"""Precision of stored features: 0.05 % is far below the noise, and memory is half."""


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """One trial as the network sees it; T windows, N frames.

    Attributes:
        window_end_us: Camera clock [us], int64 [T].
        event_features: float16 [T, grid rows, grid columns, 4].
        force: Label at the end of each window [N], float32 [T].
        across: Sideways force x, y [N] and torsion [N mm] there, nan if unknown, float32 [T, 3].
        slots: Frame that becomes available in each window, -1 for none, int64 [T].
        lags: Windows from the estimate before that to the centre of its exposure, int64 [T].
        frame_inputs: float16 [N, channels, rows, columns].
        frame_moments: Moments of each frame (`mixtac_fger.shear`), float32 [N, 9 or 0].
        frame_force: Mean label over each exposure [N], float32 [N].
        frame_across: As `across`, at the centre of each exposure, float32 [N, 3].
        origin: Seeds, profile, and the like.
    """

    window_end_us: NDArray[np.int64]
    event_features: NDArray[np.float16]
    force: NDArray[np.float32]
    across: NDArray[np.float32]
    slots: NDArray[np.int64]
    lags: NDArray[np.int64]
    frame_inputs: NDArray[np.float16]
    frame_moments: NDArray[np.float32]
    frame_force: NDArray[np.float32]
    frame_across: NDArray[np.float32]
    origin: dict[str, Any]


def make_sample(
    config: FgerConfig,
    trial: TrialArrays,
    label: ForceLabel,
    origin: dict[str, Any],
) -> Sample:
    """Compute the features of a trial, with frames available from their arrival on.

    The first `FgerConfig.reference_frames` frames must be without contact. Frames whose exposure
    the label does not cover are left out.

    Args:
        config: Network configuration.
        trial: Events and frames.
        label: Force on the camera clock.
        origin: Kept with the sample.

    Raises:
        DatasetError: The trial has too few frames, ends before they have arrived, or starts in
            contact.
    """
    kept = config.reference_frames
    width = config.window_us
    begin_us, end_us = trial.exposure_start_us, trial.exposure_end_us
    labelled = np.flatnonzero((begin_us >= label.t_us[0]) & (end_us <= label.t_us[-1]))
    labelled = labelled[labelled >= kept - 1]
    few = len(trial.frames) <= kept or not len(labelled)
    if few or label.t_us[-1] < trial.arrival_us[labelled[0]] + width:
        raise DatasetError(
            f'trial {origin} has {len(trial.frames)} frames: more than {kept} are needed, and'
            ' a label that lasts beyond them'
        )
    forces = label.mean(begin_us, end_us)
    contact_n = CONTACT_N if label is trial.truth else MEASURED_CONTACT_N
    if np.abs(forces[:kept]).max() > contact_n:
        raise DatasetError(
            f'trial {origin} starts with {np.abs(forces[:kept]).max():.2f} N: its first {kept}'
            ' frames must be without contact'
        )
    first = int(labelled[0])
    ends = window_ends(trial, label, width, int(trial.arrival_us[first]))
    slots = frame_arrivals(trial.arrival_us, ends, first)
    middle = (begin_us + end_us) // 2
    lags = [
        correction_lag(int(end) - width, int(middle[slot]), width) if slot >= 0 else 0
        for end, slot in zip(ends, slots, strict=True)
    ]
    inputs, moments, features = _features(config, trial, ends, slots, labelled)
    return Sample(
        window_end_us=ends,
        event_features=features,
        force=label.at(ends),
        across=_across(trial, ends),
        slots=np.where(slots >= 0, slots - first, -1),
        lags=np.array(lags, np.int64),
        frame_inputs=inputs,
        frame_moments=moments,
        frame_force=forces[labelled],
        frame_across=_across(trial, middle[labelled]),
        origin=origin,
    )


def _across(trial: TrialArrays, t_us: NDArray[np.int64]) -> NDArray[np.float32]:
    """Return sideways force and torsion at some times, in the units of the network."""
    if trial.across is None:
        return np.full((len(t_us), 3), np.nan, np.float32)
    return (trial.across.at(t_us) / NEWTONS).astype(np.float32)


def _features(
    config: FgerConfig,
    trial: TrialArrays,
    ends: NDArray[np.int64],
    slots: NDArray[np.int64],
    frames: NDArray[np.int64],
) -> tuple[NDArray[np.float16], NDArray[np.float32], NDArray[np.float16]]:
    """Return inputs and moments of some frames, and the event features."""
    preparation, window = FramePreparation(config), WindowFeatures(config)
    kept = config.reference_frames
    first = [preparation.contrast(frame) for frame in trial.frames[:kept]]
    reference = mean_contrast([c.coarse for c in first])
    channels = len(config.frame_channels)
    inputs = np.empty((len(frames), channels, *config.frame_shape), STORED)
    moments = []
    for index, frame in enumerate(frames):
        contrast = preparation.contrast(trial.frames[frame])
        inputs[index] = preparation.network_input(contrast, reference)
        moments.append(preparation.moments())
    out = np.zeros(window.shape, np.float32)
    features = np.empty((len(ends), *window.shape), STORED)
    guide = preparation.guide(first[-1])
    cuts = np.searchsorted(trial.events.t, [ends[0] - config.window_us, *ends])
    for index, slot in enumerate(slots):
        if slot >= 0:
            guide = preparation.guide(preparation.contrast(trial.frames[slot]))
        light = window.compute(trial.events[cuts[index] : cuts[index + 1]], guide, out)
        features[index] = 0.0 if light else out
    return inputs, np.stack(moments), features


def save_sample(path: Path, sample: Sample, config: FgerConfig) -> None:
    """Write a sample with its configuration as a folder of arrays, whole or not at all."""
    arrays = {name: getattr(sample, name) for name in _ARRAYS}
    facts = {'config': config.to_dict(), 'origin': sample.origin}
    write_arrays(path, arrays, facts, _FACTS)


_ARRAYS = Sample.__slots__[:-1]
_FACTS = 'sample.json'
UNSEEN_BY_SAMPLES = {
    'reference_stillness',
    'event_hidden',
    'event_size',
    'frame_widths',
    'frame_size',
    'lstm_size',
    'mlp_size',
    'event_shortcut',
    'frame_context',
    'deviation_size',
    'force_unit',
    'shear',
    'correction_point',
    'history_windows',
}
"""Fields of the configuration that do not change what a sample holds."""


def load_sample(path: Path, config: FgerConfig) -> Sample:
    """Read a sample and check that it was prepared as `config` asks.

    Raises:
        DatasetError: The folder is missing, damaged or was prepared in another way.
    """
    mapped, facts = read_arrays(path, _FACTS, _ARRAYS)
    wanted = config.to_dict()
    for name in set(wanted) - UNSEEN_BY_SAMPLES:
        if facts['config'].get(name) != wanted[name]:
            raise DatasetError(
                f'sample {path} was prepared with {name} = {facts["config"].get(name)}, but'
                f' {wanted[name]} is needed: remove it'
            )
    arrays = {name: np.array(mapped[name]) for name in _ARRAYS}
    return Sample(**arrays, origin=facts['origin'])


def sample_origin(path: Path) -> dict[str, Any]:
    """Return where a sample came from.

    Raises:
        DatasetError: The folder cannot be read.
    """
    return dict(read_arrays(path, _FACTS, ())[1]['origin'])


def sample_windows(path: Path) -> int:
    """Return the number of windows of a sample.

    Raises:
        DatasetError: The folder cannot be read.
    """
    return len(read_arrays(path, _FACTS, ('force',))[0]['force'])


@dataclass(frozen=True, slots=True)
class FgerRecipe:
    """Features of frames and windows, in one folder per trial.

    Attributes:
        config: Network configuration.
    """

    config: FgerConfig
    suffix = '.fger'

    def fingerprint(self) -> dict[str, Any]:
        """Return what changes a sample."""
        fields = self.config.to_dict()
        kept = {name: fields[name] for name in fields if name not in UNSEEN_BY_SAMPLES}
        return {'kind': 'fger 7'} | kept

    def write(self, trial: TrialArrays, path: Path) -> None:
        """Prepare a trial and write it, whole or not at all.

        Raises:
            DatasetError: As `make_sample`, or the trial has no such force.
        """
        sample = make_sample(self.config, trial, trial.label(), trial.origin)
        save_sample(path, sample, self.config)
