# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""All bags of a data set, in parallel; resumes where it ended."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import joblib
from joblib.externals.loky.process_executor import TerminatedWorkerError

from mixtac_node.files import locked
from mixtac_recordings.dataset import FILE_NAME, DatasetDescription
from mixtac_recordings.recording import RecordingError
from mixtac_sim.bags.trial_bag import UNFINISHED, is_finished, write_trial


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
        RecordingError: The folder holds something else, is in use, or cannot be written.
        SimulationError: A trial cannot be simulated.
    """
    with _exclusive(folder):
        _claim(folder, description)
        waiting = [each for each in description.trials if not is_finished(folder, each.name)]
        total = len(description.trials)
        on_progress(total - len(waiting), total)
        if waiting:
            calls = [
                joblib.delayed(write_trial)(spec, folder, compress=compress) for spec in waiting
            ]
            try:
                written = joblib.Parallel(
                    n_jobs=jobs, return_as='generator_unordered', batch_size=1
                )(calls)
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


@contextlib.contextmanager
def _exclusive(folder: Path) -> Iterator[None]:
    """Keep other runs out of a folder, which is made if need be."""
    with contextlib.ExitStack() as stack:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            stack.enter_context(locked(folder, wait=False))
        except BlockingIOError as error:
            raise RecordingError(
                f'another run is writing to {folder}', remedy='wait until it ends'
            ) from error
        except OSError as error:
            raise RecordingError(
                f'cannot use folder {folder}: {error}', remedy='choose another folder'
            ) from error
        yield


def _claim(folder: Path, description: DatasetDescription) -> None:
    """Check that a folder is free or holds this very data set, and describe it."""
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
