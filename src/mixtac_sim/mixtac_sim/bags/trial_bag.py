# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Simulated trials as rosbag2 bags: the topics of the live graph, and the truth.

A bag is written whole or not at all. The bags of a data set are written in parallel, and a run that
was interrupted resumes where it ended.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Final

import joblib
from joblib.externals.loky.process_executor import TerminatedWorkerError

from mixtac_core.recordings.bag_writer import McapBag
from mixtac_core.recordings.dataset import FILE_NAME, DatasetDescription, TrialSpec
from mixtac_core.recordings.recording import RecordingError
from mixtac_sim.bags.messages import TrialWriter
from mixtac_sim.world.trial import TrialStream

UNFINISHED: Final = '.unfinished'
"""Folder of half-written bags beside the finished ones."""


def is_finished(folder: Path, name: str) -> bool:
    """Return whether the bag of a trial has been written."""
    return (folder / name / 'metadata.yaml').is_file()


def write_trial(spec: TrialSpec, folder: Path, *, compress: bool = False) -> None:
    """Write the bag of a trial, unless it is there already.

    The bag is written to a temporary folder and moved when it is complete.

    Args:
        spec: The trial.
        folder: Folder of the data set.
        compress: Compress the chunks of the bag (zstd).

    Raises:
        SimulationError: The trial cannot be simulated.
        RecordingError: The bag cannot be written.
    """
    if is_finished(folder, spec.name):
        return
    partial = folder / UNFINISHED / spec.name
    trial = TrialStream(spec)
    try:
        shutil.rmtree(partial, ignore_errors=True)
        partial.parent.mkdir(parents=True, exist_ok=True)
        writer = McapBag(partial, compressed=compress)
        writer.set_custom_data('mixtac.simulated', 'true')
        writer.set_custom_data('mixtac.trial', json.dumps(asdict(spec)))
        with writer:
            TrialWriter(writer, trial).write()
        partial.rename(folder / spec.name)
    except OSError as error:
        raise RecordingError(
            f'cannot write bag {folder / spec.name}: {error}',
            remedy='free some space, or choose another folder',
        ) from error


def generate(
    description: DatasetDescription,
    folder: Path,
    *,
    jobs: int = 1,
    compress: bool = False,
    on_progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> int:
    """Write the bags of a data set that are not there yet, and its description.

    Args:
        description: The data set.
        folder: Its folder; new, empty, or that of an earlier run of the same data set.
        jobs: Processes.
        compress: Compress the bags (zstd).
        on_progress: Called with the number of finished trials and of all.

    Returns:
        Number of bags written by this run.

    Raises:
        RecordingError: The folder holds something else, or cannot be written.
        SimulationError: A trial cannot be simulated.
    """
    _claim(folder, description)
    waiting = [each for each in description.trials if not is_finished(folder, each.name)]
    total = len(description.trials)
    on_progress(total - len(waiting), total)
    if waiting:
        calls = [joblib.delayed(write_trial)(spec, folder, compress=compress) for spec in waiting]
        try:
            written = joblib.Parallel(n_jobs=jobs, return_as='generator_unordered', batch_size=1)(
                calls
            )
            for done, _ in enumerate(written, total - len(waiting) + 1):
                on_progress(done, total)
        except TerminatedWorkerError as error:
            raise RecordingError(
                'a worker process was killed, probably out of memory; finished bags are kept',
                remedy='use fewer jobs',
            ) from error
    shutil.rmtree(folder / UNFINISHED, ignore_errors=True)
    replace(description, complete=True).write(folder)

    return len(waiting)


def _claim(folder: Path, description: DatasetDescription) -> None:
    """Make a folder, check that it is empty or holds this very data set, and describe it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RecordingError(
            f'cannot use folder {folder}: {error}', remedy='choose another folder'
        ) from error
    if (folder / FILE_NAME).exists():
        if not DatasetDescription.read(folder).same_trials_as(description):
            raise RecordingError(
                f'{folder} holds a data set of other trials or of another simulator version',
                remedy='choose another folder',
            )
        return
    if any(folder.iterdir()):
        raise RecordingError(
            f'{folder} is not empty and holds no data set', remedy='choose another folder'
        )
    description.write(folder)
