# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Results of long computations on disk, keyed by inputs and by the version of the code.

A run that was interrupted continues where it stopped: a piece of work is computed only if no
result is stored for it. Results are JSON that people can read; larger arrays are in files beside
them whose names begin with the same stem. `joblib.Memory` keys a function by its own source only,
not by the packages it calls, and stores pickles, so it is not used here; `joblib.Parallel` is.
"""

from __future__ import annotations

import functools
import hashlib
import json
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import joblib

from mixtac_events.errors import MixtacError
from mixtac_node.files import write_json


@functools.cache
def code_version(*names: str) -> str:
    """Return a digest of packages and modules.

    Args:
        names: Full names, such as `mixtac_sim.optics`; a package counts with all that is in it, its
            data too.
    """
    digest = hashlib.blake2b(digest_size=6)
    for name in names:
        spec = find_spec(name)
        if spec is None or spec.origin is None:
            raise ModuleNotFoundError(name)
        origin = Path(spec.origin)
        root = origin.parent
        files = sorted(root.rglob('*')) if spec.submodule_search_locations else [origin]
        for path in files:
            if path.is_file() and path.parent.name != '__pycache__':
                digest.update(str(path.relative_to(root)).encode() + path.read_bytes())
    return digest.hexdigest()


def files_version(paths: Sequence[Path]) -> str:
    """Return what changes when files do: their paths, sizes and dates."""
    return json.dumps([(str(p), p.stat().st_size, p.stat().st_mtime_ns) for p in paths])


@dataclass(frozen=True, slots=True)
class Piece:
    """One piece of work; can be sent to another process.

    Attributes:
        label: Prefix of its file names.
        function: Called with the path of the result without suffix, as prefix of the names of
            further files, and with `arguments`; returns the result, ready for JSON.
        arguments: Everything else that the function needs; their `repr` is part of the key.
        version: Version of the code and of the files that the result depends on; that of the module
            of the function is added.
    """

    label: str
    function: Callable[..., dict[str, Any]]
    arguments: tuple[Any, ...]
    version: str

    def __post_init__(self) -> None:
        """Add the version of the function's module, which stays if the file changes meanwhile."""
        version = f'{self.version} {code_version(self.function.__module__)}'
        object.__setattr__(self, 'version', version)

    @property
    def stem(self) -> str:
        """Name of its files without suffix: label and digest of the key."""
        key = f'{self.function.__qualname__} {self.arguments!r} {self.version}'
        return f'{self.label}-{hashlib.blake2b(key.encode(), digest_size=6).hexdigest()}'


class Store:
    """Results in a folder.

    Args:
        folder: The folder; None for a temporary one that is removed together with the store.

    Attributes:
        folder: The folder.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self._temporary = None
        if folder is None:
            self._temporary = tempfile.TemporaryDirectory(prefix='mixtac-')
            folder = Path(self._temporary.name)
        if folder.is_file():
            raise MixtacError(
                f'{folder} is a file of an older version', remedy='name a folder for the results'
            )
        folder.mkdir(parents=True, exist_ok=True)
        self.folder = folder

    def path(self, piece: Piece, suffix: str = '.json') -> Path:
        """Return the path of the result of a piece, or of one of its other files."""
        return self.folder / f'{piece.stem}{suffix}'

    def find(self, piece: Piece) -> dict[str, Any] | None:
        """Return the stored result of a piece, None if there is none or it is damaged."""
        try:
            found: dict[str, Any] = json.loads(self.path(piece).read_text(encoding='utf-8'))
        except (OSError, ValueError):
            return None
        return found

    def run(
        self,
        pieces: Sequence[Piece],
        jobs: int = 1,
        advance: Callable[[], object] = lambda: None,
    ) -> list[dict[str, Any]]:
        """Return the results of pieces in their order; only missing ones are computed.

        Args:
            pieces: What to do.
            jobs: Number of processes.
            advance: Called after each piece.

        Raises:
            MixtacError: A piece failed; the results of finished pieces stay stored.
        """
        results: dict[int, dict[str, Any]] = {}
        missing = []
        for index, piece in enumerate(pieces):
            found = self.find(piece)
            if found is None:
                missing.append(index)
            else:
                results[index] = found
                advance()
        calls = [joblib.delayed(_compute)(index, pieces[index], self.folder) for index in missing]
        processes = min(jobs, len(missing)) or 1
        # Processes share the cores, so each gets one thread.
        with joblib.parallel_config('loky', n_jobs=processes, inner_max_num_threads=1):
            finished = joblib.Parallel(return_as='generator_unordered', batch_size=1)(calls)
            for index, result in finished:
                results[index] = result
                advance()
        return [results[index] for index in range(len(pieces))]


def _compute(index: int, piece: Piece, folder: Path) -> tuple[int, dict[str, Any]]:
    result = piece.function(folder / piece.stem, *piece.arguments)
    write_json(folder / f'{piece.stem}.json', result)
    return index, result
