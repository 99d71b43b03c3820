# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Results of long computations in a folder: an interrupted run continues where it stopped.

A result is JSON that people can read, named after a digest of inputs, code and files. Larger arrays
are in files beside it whose names begin with the same stem.
"""

from __future__ import annotations

import functools
import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import joblib

from mixtac_core.node.files import write_json


@functools.cache
def code_version(*names: str) -> str:
    """Return a digest of packages, with all their files, and of modules, by their full names."""
    digest = hashlib.blake2b(digest_size=6)
    for name in names:
        spec = find_spec(name)
        if spec is None or spec.origin is None:
            raise ModuleNotFoundError(name)
        root = Path(spec.origin).parent
        files = root.rglob('*') if spec.submodule_search_locations else [Path(spec.origin)]
        for path in sorted(files):
            if path.is_file() and path.parent.name != '__pycache__':
                digest.update(str(path.relative_to(root)).encode() + path.read_bytes())
    return digest.hexdigest()


@dataclass(frozen=True, slots=True)
class Piece:
    """One piece of work; can be sent to another process.

    Attributes:
        label: Prefix of its file names.
        function: Called with the path of the result without suffix, which is the prefix for further
            files, and with `arguments`; returns the result, ready for JSON.
        arguments: Everything else that the function needs; their `repr` is part of the digest.
        code: Packages and modules that the result depends on, besides the function's module.
        files: Files that the result depends on, by path, size and date.
        stem: Name of its files without suffix.
    """

    label: str
    function: Callable[..., dict[str, Any]]
    arguments: tuple[Any, ...]
    code: tuple[str, ...] = ()
    files: tuple[Path, ...] = ()
    stem: str = field(init=False)

    def __post_init__(self) -> None:
        """Make the stem, which stays if a file changes meanwhile."""
        code = code_version(self.function.__module__, *self.code)
        files = [(str(p), p.stat().st_size, p.stat().st_mtime_ns) for p in self.files]
        key = f'{self.function.__qualname__} {self.arguments!r} {code} {files}'
        digest = hashlib.blake2b(key.encode(), digest_size=6).hexdigest()
        object.__setattr__(self, 'stem', f'{self.label}-{digest}')


def find_result(folder: Path, piece: Piece) -> dict[str, Any] | None:
    """Return the stored result of a piece, None if there is none or it is damaged."""
    try:
        found: dict[str, Any] = json.loads((folder / f'{piece.stem}.json').read_text('utf-8'))
    except (OSError, ValueError):
        return None
    return found


def compute(
    folder: Path, pieces: Sequence[Piece], jobs: int = 1, advance: Callable[[], Any] = lambda: None
) -> list[dict[str, Any]]:
    """Return the results of pieces in their order; compute and store the missing ones.

    Args:
        folder: Folder of the results.
        pieces: What to compute.
        jobs: Number of processes.
        advance: Called after each piece.

    Raises:
        MixtacError: A piece failed; the results of finished pieces stay stored.
    """
    folder.mkdir(parents=True, exist_ok=True)
    results = [find_result(folder, piece) for piece in pieces]
    missing = [index for index, result in enumerate(results) if result is None]
    for _ in range(len(pieces) - len(missing)):
        advance()
    calls = [joblib.delayed(_compute)(folder, index, pieces[index]) for index in missing]
    # Processes share the cores, so each gets one thread.
    with joblib.parallel_config(
        'loky', n_jobs=min(jobs, len(missing)) or 1, inner_max_num_threads=1
    ):
        parallel = joblib.Parallel(return_as='generator_unordered', batch_size=1)
        for index, result in parallel(calls):
            results[index] = result
            advance()
    return [result for result in results if result is not None]


def _compute(folder: Path, index: int, piece: Piece) -> tuple[int, dict[str, Any]]:
    result = piece.function(folder / piece.stem, *piece.arguments)
    write_json(folder / f'{piece.stem}.json', result)
    return index, result
