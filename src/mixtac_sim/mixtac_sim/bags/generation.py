# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""All bags of a data set, in parallel on this machine or a Dask cluster; resumes where it ended."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import joblib
from joblib.externals.loky.process_executor import TerminatedWorkerError

from mixtac_node.files import locked
from mixtac_recordings.dataset import FILE_NAME, DatasetDescription
from mixtac_recordings.recording import RecordingError
from mixtac_sim.bags.trial_bag import UNFINISHED, is_finished, write_trial

BACKENDS: Final = ('loky', 'dask')


@contextlib.contextmanager
def workers(backend: str, jobs: int, scheduler: str = '') -> Iterator[None]:
    """Let joblib's parallel calls run on a backend.

    Args:
        backend: `loky` for processes of this machine, `dask` for a Dask cluster.
        jobs: Processes; with a running scheduler its workers count instead.
        scheduler: Address of a running Dask scheduler, for example `tcp://host:8786`; empty
            starts a cluster on this machine. Its workers need this software and the output folder.

    Raises:
        RecordingError: Unknown backend, Dask is not installed, or the scheduler does not answer.
    """
    if backend not in BACKENDS:
        raise RecordingError(
            f'unknown backend {backend!r}', remedy=f'choose one of {", ".join(BACKENDS)}'
        )
    if backend == 'loky':
        with joblib.parallel_config('loky', n_jobs=jobs, inner_max_num_threads=1):
            yield
        return
    with _client(jobs, scheduler), joblib.parallel_config('dask'):
        yield


def _client(jobs: int, scheduler: str) -> Any:  # noqa: ANN401
    try:
        from dask.distributed import Client
    except ImportError as error:
        raise RecordingError(
            f'backend dask is not installed: {error}',
            remedy='pip install -r requirements/cluster.txt',
        ) from error
    try:
        if scheduler:
            return Client(scheduler)
        return Client(
            n_workers=jobs, threads_per_worker=1, dashboard_address=None, host='127.0.0.1'
        )
    except OSError as error:
        raise RecordingError(
            f'no Dask scheduler at {scheduler!r}: {error}',
            remedy='start one with `dask scheduler`',
        ) from error


def generate(
    description: DatasetDescription,
    folder: Path,
    *,
    jobs: int = 1,
    backend: str = 'loky',
    scheduler: str = '',
    compress: bool = False,
    on_progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> int:
    """Write the bags of a data set that are not there yet, and its description.

    Args:
        description: The data set.
        folder: Its folder; new, empty, or that of an earlier run of the same data set.
        jobs: Processes.
        backend: As in `workers`.
        scheduler: As in `workers`.
        compress: Compress the bags (zstd).
        on_progress: Called with the number of finished trials and of all.

    Returns:
        Number of bags written by this run.

    Raises:
        RecordingError: The folder holds something else, is in use, or cannot be written.
        SimulationError: A trial cannot be simulated.
    """
    with workers(backend, jobs, scheduler), _exclusive(folder):
        _claim(folder, description)
        waiting = [each for each in description.trials if not is_finished(folder, each.name)]
        total = len(description.trials)
        on_progress(total - len(waiting), total)
        if waiting:
            calls = [
                joblib.delayed(write_trial)(spec, folder, compress=compress) for spec in waiting
            ]
            try:
                written = joblib.Parallel(return_as='generator_unordered', batch_size=1)(calls)
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
