# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Where trials are simulated: processes of this machine, or a Dask cluster."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Any, Final

import joblib

from mixtac_bringup.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Iterator

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
        BagError: Unknown backend, Dask is not installed, or the scheduler does not answer.
    """
    if backend not in BACKENDS:
        raise BagError(f'backend {backend!r} is unknown: choose one of {", ".join(BACKENDS)}')
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
        raise BagError(
            f'backend dask is not installed ({error}): pip install "dask[distributed]"'
        ) from error
    try:
        if scheduler:
            return Client(scheduler)
        return Client(
            n_workers=jobs, threads_per_worker=1, dashboard_address=None, host='127.0.0.1'
        )
    except OSError as error:
        raise BagError(
            f'no Dask scheduler at {scheduler!r} ({error}): start one with `dask scheduler`'
        ) from error
