# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""From trials to prepared samples on disk, keyed by what they hold and how they were prepared."""

from __future__ import annotations

import hashlib
import json
import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

from mixtac_events.errors import MixtacError
from mixtac_fger.errors import DatasetError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence
    from pathlib import Path

    from mixtac_fger.trials.trial_arrays import TrialArrays
    from mixtac_fger.trials.trial_source import TrialSource


class Recipe(Protocol):
    """How a network wants its samples; must survive being sent to another process."""

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
    """Samples on disk, and the trials that gave none.

    Attributes:
        paths: Files, in the order of their sources.
        skipped: Why a trial was left out, by its name.
        kept: Which of the sources gave a sample, by index.
    """

    paths: list[Path]
    skipped: dict[str, str]
    kept: list[int]


def sample_path(source: TrialSource, recipe: Recipe, folder: Path) -> Path:
    """Return where the sample of a source lies: its name and a digest of content and recipe."""
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
    named; the others go on.

    Args:
        sources: Trials.
        recipe: How to prepare them.
        folder: Where samples are kept.
        jobs: Processes.
        on_progress: Called with the number of trials done.

    Raises:
        DatasetError: No trial can be used.
    """
    folder.mkdir(parents=True, exist_ok=True)
    paths, skipped, kept = [], {}, []
    arguments = ([*sources], [recipe] * len(sources), [folder] * len(sources))
    results: Iterable[tuple[Path | None, str]] = map(_prepare_one, *arguments)
    pool = None
    if jobs > 1:
        context = multiprocessing.get_context('spawn')
        pool = ProcessPoolExecutor(jobs, mp_context=context)
        results = pool.map(_prepare_one, *arguments)
    try:
        for index, (path, reason) in enumerate(results):
            if path is None:
                skipped[sources[index].name] = reason
            else:
                paths.append(path)
                kept.append(index)
            on_progress(index + 1)
    finally:
        if pool is not None:
            pool.shutdown(cancel_futures=True)
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
