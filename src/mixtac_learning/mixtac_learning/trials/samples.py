# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Training samples on disk, and those of FGER-Net: features of a trial, force of each window.

Samples are keyed by the content of their trial and by their recipe.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import joblib
import numpy as np
from numpy.typing import NDArray

from mixtac_core.events.errors import MixtacError
from mixtac_core.node.files import FileError, new_folder
from mixtac_fger.config import FgerConfig
from mixtac_fger.features import FramePreparation, WindowFeatures, correction_lag, mean_contrast
from mixtac_fger.force_path import NEWTONS
from mixtac_learning.trials.trial import DatasetError, TrialArrays, frame_arrivals, window_ends

if TYPE_CHECKING:
    from mixtac_learning.trials.bags import TrialSource

FACTS_FILE = 'origin.json'
"""File of the origin of a trial in the folder of its sample."""
SampleT = TypeVar('SampleT')


def save_sample(path: Path, sample: Any) -> None:  # noqa: ANN401
    """Write a sample as a folder of arrays that can be mapped, whole or not at all.

    Processes may write the same folder at the same time: the first one's stays.

    Args:
        path: Folder to write.
        sample: A dataclass of arrays, and its `origin`, which is ready for JSON.

    Raises:
        FileError: It cannot be written.
    """
    try:
        with new_folder(path) as folder:
            folder.mkdir()
            for each in fields(sample):
                if each.name != 'origin':
                    np.save(folder / f'{each.name}.npy', getattr(sample, each.name))
            (folder / FACTS_FILE).write_text(json.dumps(sample.origin), encoding='utf-8')
    except FileError:
        if not path.is_dir():
            raise


def load_sample(path: Path, kind: type[SampleT]) -> SampleT:
    """Return a sample; its arrays are mapped.

    Args:
        path: Folder that `save_sample` wrote.
        kind: Class of the sample.

    Raises:
        DatasetError: The folder is missing or damaged.
    """
    try:
        found = {'origin': json.loads((path / FACTS_FILE).read_text(encoding='utf-8'))}
        for each in fields(kind):  # type: ignore[arg-type]
            if each.name != 'origin':
                found[each.name] = np.load(path / f'{each.name}.npy', mmap_mode='r')
    except (OSError, EOFError, ValueError) as error:
        raise DatasetError(
            f'{path} cannot be read ({error})', remedy='remove it; it is then prepared again'
        ) from error
    return kind(**found)


@dataclass(frozen=True, slots=True)
class Recipe:
    """How the samples of a network are made; can be sent to other processes.

    Attributes:
        name: Suffix of the folders.
        config: Configuration of the network.
        make: Returns the sample of a trial, by `config` and the trial.
        facts: Everything that changes what a sample holds, ready for JSON.
    """

    name: str
    config: Any
    make: Callable[[Any, TrialArrays], Any]
    facts: dict[str, Any]

    def path(self, source: TrialSource, folder: Path) -> Path:
        """Return the folder of a trial's sample: its name and a digest of content and recipe."""
        described = json.dumps([source.content_key(), self.facts], sort_keys=True)
        digest = hashlib.blake2b(described.encode(), digest_size=8).hexdigest()
        return folder / f'{source.name}-{digest}.{self.name}'


def prepare(
    sources: Sequence[TrialSource],
    recipes: Sequence[Recipe],
    folder: Path,
    jobs: int = 1,
    on_progress: Callable[[int], None] = lambda _done: None,
) -> tuple[dict[int, list[Path]], dict[str, str]]:
    """Make sure that the samples of all sources are on disk.

    One trial per process is in memory at a time.

    Args:
        sources: Trials.
        recipes: Recipes of the samples; each trial is loaded once for all of them.
        folder: Folder of the samples.
        jobs: Processes.
        on_progress: Called with the number of trials done.

    Returns:
        Folders of the samples of each trial by its index, one per recipe; and why a trial is left
        out, by its name.

    Raises:
        DatasetError: No trial can be used.
    """
    # joblib keeps its processes, with the working folder in which they were started.
    folder = folder.absolute()
    folder.mkdir(parents=True, exist_ok=True)
    paths, skipped = {}, {}
    calls = [joblib.delayed(_prepare_one)(source, recipes, folder) for source in sources]
    results = joblib.Parallel(jobs, return_as='generator', batch_size=1)(calls)
    for index, (found, reason) in enumerate(results):
        if found:
            paths[index] = found
        else:
            skipped[sources[index].name] = reason
        on_progress(index + 1)
    if not paths:
        first = next(iter(skipped.values()), 'there are none')
        raise DatasetError(f'none of {len(sources)} trials can be used: {first}')
    return paths, skipped


def _prepare_one(
    source: TrialSource, recipes: Sequence[Recipe], folder: Path
) -> tuple[list[Path], str]:
    try:
        paths = [recipe.path(source, folder) for recipe in recipes]
        missing = [pair for pair in zip(paths, recipes, strict=True) if not pair[0].exists()]
        if missing:
            trial = source.load()
            for path, recipe in missing:
                save_sample(path, recipe.make(recipe.config, trial))
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
        frame_moments: Moments of each frame (`mixtac_fger.moments`), float32 [N, 14].
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
    frame_moments: NDArray[np.float32]
    frame_force: NDArray[np.float32]
    frame_across: NDArray[np.float32]
    origin: dict[str, Any]


def make_sample(config: FgerConfig, trial: TrialArrays) -> Sample:
    """Compute the features of a trial, with frames available from their arrival on.

    The first `FgerConfig.reference_frames` frames must be without contact. Frames whose exposure
    the label does not cover are left out.

    Args:
        config: Network configuration.
        trial: Events, frames and force.

    Raises:
        DatasetError: The trial has no known force or too few frames, ends before they have arrived,
            or starts in contact.
    """
    label, kept, width = trial.label(), config.reference_frames, config.window_us
    name = trial.origin.get('name')
    begin_us, end_us = trial.exposure_start_us, trial.exposure_end_us
    labelled = np.flatnonzero((begin_us >= label.t_us[0]) & (end_us <= label.t_us[-1]))
    labelled = labelled[labelled >= kept - 1]
    few = len(trial.frames) <= kept or not len(labelled)
    if few or label.t_us[-1] < trial.arrival_us[labelled[0]] + width:
        raise DatasetError(
            f'trial {name} has {len(trial.frames)} frames: more than {kept} are needed, and'
            ' a label that lasts beyond them'
        )
    forces = label.mean(begin_us, end_us)
    contact_n = CONTACT_N if label is trial.truth else MEASURED_CONTACT_N
    if np.abs(forces[:kept]).max() > contact_n:
        raise DatasetError(
            f'trial {name} starts with {np.abs(forces[:kept]).max():.2f} N: its first {kept}'
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
    moments, features = _features(config, trial, ends, slots, labelled)
    return Sample(
        window_end_us=ends,
        event_features=features,
        force=label.at(ends),
        across=_across(trial, ends),
        slots=np.where(slots >= 0, slots - first, -1),
        lags=np.array(lags, np.int64),
        frame_moments=moments,
        frame_force=forces[labelled],
        frame_across=_across(trial, middle[labelled]),
        origin=trial.origin,
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
) -> tuple[NDArray[np.float32], NDArray[np.float16]]:
    """Return the moments of some frames, and the event features."""
    preparation, window = FramePreparation(config), WindowFeatures(config)
    kept = config.reference_frames
    first = [preparation.contrast(frame) for frame in trial.frames[:kept]]
    reference = mean_contrast([c.coarse for c in first])
    moments = [
        preparation.compare(preparation.contrast(trial.frames[frame]), reference)[0]
        for frame in frames
    ]
    out = np.zeros(window.shape, np.float32)
    features = np.empty((len(ends), *window.shape), STORED)
    guide = preparation.guide(first[-1])
    cuts = np.searchsorted(trial.events.t, [ends[0] - config.window_us, *ends])
    for index, slot in enumerate(slots):
        if slot >= 0:
            guide = preparation.guide(preparation.contrast(trial.frames[slot]))
        light = window.compute(trial.events[cuts[index] : cuts[index + 1]], guide, out)
        features[index] = 0.0 if light else out
    return np.stack(moments), features


UNSEEN_BY_SAMPLES = {
    *('reference_stillness', 'event_hidden', 'event_size', 'lstm_size', 'mlp_size'),
    *('force_unit', 'shear'),
    'history_windows',
}
"""Fields of the configuration that do not change what a sample holds."""


def fger_recipe(config: FgerConfig) -> Recipe:
    """Return the recipe of the samples of FGER-Net."""
    kept = {name: v for name, v in asdict(config).items() if name not in UNSEEN_BY_SAMPLES}
    return Recipe('fger', config, make_sample, {'kind': 'fger 10'} | kept)
